# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake leaves on an object: shape keys, or a point cache."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender import point_cache, shape_keys

#: "keys": relative shape keys on the mesh. "absolute": absolute ones, in a row.
#: "pc2": a .pc2 file beside the .blend and a Mesh Cache modifier.
OutputKind = Literal["keys", "absolute", "pc2"]
OUTPUTS: tuple[OutputKind, ...] = get_args(OutputKind)


def write(
    obj: bpy.types.Object,
    kind: OutputKind,
    frames: Sequence[int],
    offsets: NDArray[np.float32],
    rest: NDArray[np.float64],
    blend: Path | None,
    frame_length: float,
) -> None:
    """Replace what an earlier bake made on this object, of whichever kind.

    See `shape_keys.write` and `point_cache.write` for the parameters; `blend` is the file that will play it.
    """
    if kind != "pc2":
        shape_keys.write(obj, frames, offsets, frame_length, absolute=kind == "absolute")
        point_cache.clear(obj)
        return
    if blend is None:
        raise ValueError("blend: found None, expected the file beside which the point cache lies")
    point_cache.write(obj, frames, offsets, rest, point_cache.path_of(blend, obj.name), frame_length)
    if obj.data.library is None:
        shape_keys.clear(obj)


def clear(obj: bpy.types.Object) -> bool:
    """Remove exactly what a bake made on this object.

    Returns
    -------
    False where there was nothing to remove.
    """
    if obj.type != "MESH":
        return False
    had_cache = point_cache.clear(obj)
    return (obj.data.library is None and shape_keys.clear(obj)) or had_cache


def baked_range(obj: bpy.types.Object) -> tuple[int, int] | None:
    """First and last frame of the bake that this object carries; None where it carries none."""
    return point_cache.baked_range(obj) or shape_keys.baked_range(obj)
