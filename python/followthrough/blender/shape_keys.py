# SPDX-License-Identifier: GPL-3.0-or-later
"""Our shape keys on a mesh: one a frame, relative, animated by an action of their own.

Keys and animation of others are never touched.
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np
from numpy.typing import NDArray


def write(obj: bpy.types.Object, frames: Sequence[int], offsets: NDArray[np.float32]) -> None:
    """Replace our shape keys on this mesh.

    Parameters
    ----------
    frames
        Scene frames, ascending and without gaps.
    offsets : (frames, v, 3) float32
        What each key adds to the Basis, in object space.
    """
    raise NotImplementedError


def clear(obj: bpy.types.Object) -> bool:
    """Remove exactly what a bake made on this mesh: keys, action, and the Basis where we made it and no other is left.

    Returns
    -------
    False where there was nothing to remove.
    """
    raise NotImplementedError


def baked_range(obj: bpy.types.Object) -> tuple[int, int] | None:
    """First and last frame of the bake that this mesh carries; None where it carries none."""
    raise NotImplementedError
