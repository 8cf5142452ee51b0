# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as a point cache: a .pc2 file beside the .blend, and a Mesh Cache modifier before all others that plays it.

The file holds what the shape keys would: the rest shape plus a frame's offset, which the rig then deforms; a frame of rest before the
first one and after the last one, so that nothing moves outside. The mesh itself is not touched, so it may be linked from another
file, where shape keys would be lost, or shared.

PC2 is little-endian: "POINTCACHE2" and a zero byte, then as int32 or float32 the version 1, points, first frame, frames a sample,
samples; then points times samples times x, y, z as float32.
"""

from __future__ import annotations

import hashlib
import re
import struct
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.npz_files import written_whole

#: Our modifier is known by its name, which also says the frames: a library override keeps that, and no custom property.
_NAME = re.compile(r"Followthrough (-?\d+) to (-?\d+)")


def write(
    obj: bpy.types.Object,
    frames: Sequence[int],
    offsets: NDArray[np.float32],
    rest: NDArray[np.float64],
    path: Path,
    frame_length: float = 1.0,
) -> None:
    """Write the file, and let the object play it in place of what an earlier bake made.

    Parameters
    ----------
    frames
        Scene frames, ascending and without gaps.
    offsets : (frames, v, 3) float32
        What each frame adds to the rest shape, in object space.
    rest : (v, 3) float64
        The rest shape.
    path
        The file; see `path_of`.
    frame_length
        `actions.frame_length` of the scene that plays it.

    Raises
    ------
    ValueError, OSError
        Where the file cannot be written, or the modifier cannot be put first; the object is then as it was.
    """
    if offsets.shape != (len(frames), len(rest), 3) or not len(frames):
        raise ValueError(f"offsets: found shape {offsets.shape}, expected ({len(frames)}, {len(rest)}, 3)")
    still = rest.astype("<f4")
    with written_whole(path) as unfinished, unfinished.open("wb") as file:
        file.write(struct.pack("<12siiffi", b"POINTCACHE2\0", 1, len(rest), 0.0, 1.0, len(frames) + 2))
        file.write(still.tobytes())
        for offset in offsets:
            file.write((still + offset).astype("<f4").tobytes())
        file.write(still.tobytes())
    clear(obj)
    modifier = obj.modifiers.new(f"Followthrough {frames[0]} to {frames[-1]}", "MESH_CACHE")
    try:
        obj.modifiers.move(len(obj.modifiers) - 1, 0)
    except RuntimeError:
        pass  # told below
    if obj.modifiers[0] != modifier:
        obj.modifiers.remove(modifier)
        raise ValueError(
            f"Object '{obj.name}': its modifiers come from another file, and none can be put before them: make the object local"
        )
    modifier.cache_format = "PC2"
    modifier.filepath = bpy.path.relpath(str(path)) if bpy.data.filepath else str(path)
    modifier.interpolation = "LINEAR"
    modifier.frame_start, modifier.frame_scale = frames[0] - 1, 1.0 / frame_length


def clear(obj: bpy.types.Object) -> bool:
    """Take our modifier off; the file stays, so that this can be undone.

    Returns
    -------
    False where there was nothing to remove.
    """
    name = our_modifier(obj)
    if name is None:
        return False
    obj.modifiers.remove(obj.modifiers[name])
    return True


def our_modifier(obj: bpy.types.Object) -> str | None:
    """Name of the modifier that a bake made; None where there is none."""
    ours = (modifier.name for modifier in obj.modifiers if modifier.type == "MESH_CACHE" and _NAME.match(modifier.name))
    return next(ours, None)


def baked_range(obj: bpy.types.Object) -> tuple[int, int] | None:
    """First and last frame of the bake that this object plays; None where it plays none."""
    found = _NAME.match(our_modifier(obj) or "")
    return None if found is None else (int(found[1]), int(found[2]))


def path_of(blend: Path, name: str) -> Path:
    """The file of an object of this name, beside the .blend."""
    plain = re.sub(r"[^\w-]+", "_", name)
    mark = "" if plain == name else f"-{hashlib.blake2b(name.encode(), digest_size=3).hexdigest()}"
    return blend.absolute().parent / f"{blend.stem}_{plain}{mark}.pc2"
