# SPDX-License-Identifier: GPL-3.0-or-later
"""The one shape key that shows a live preview. It says on the mesh how it goes away, so that none stays behind.

Undo, autosave and a crash may bring back a file in which a preview was running: whoever finds such a key can take it off
(`remove_left_over`), and the mesh is as it was before the preview.
"""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender.earlier_bake import HiddenBake, hide_bake, show_bake
from followthrough.blender.modes import object_mode
from followthrough.blender.shape_keys import (
    PREVIEW,
    add_passing_key,
    read_points,
    remove_passing_key,
    same_active_key,
    show_points,
)
from followthrough.character import FloatArray

NAME = "Followthrough Preview"


def put(obj: bpy.types.Object) -> NDArray[np.float32]:
    """Give a mesh the key, and hide an earlier bake. A key that is there is taken off first.

    Returns
    -------
    The Basis (v, 3), for `show`.
    """
    remove(obj)
    with object_mode(obj.name), same_active_key(obj):
        hidden = hide_bake(obj)
        name, made_basis = add_passing_key(obj, NAME)
        key = obj.data.shape_keys
        key[PREVIEW] = json.dumps({"name": name, "made_basis": made_basis, "hidden": dataclasses.asdict(hidden)})
    return read_points(key.reference_key)


def is_on(obj: bpy.types.Object) -> bool:
    """Whether the mesh has the key."""
    key = obj.data.shape_keys if obj.type == "MESH" else None
    return key is not None and PREVIEW in key and json.loads(key[PREVIEW])["name"] in key.key_blocks


def show(obj: bpy.types.Object, basis: NDArray[np.float32], offsets: FloatArray) -> None:
    """Let the key add these offsets (v, 3), object space, to its Basis (v, 3)."""
    show_points(obj.data, _block(obj).name, np.add(basis, offsets, dtype=np.float32, casting="same_kind"))


def pause(obj: bpy.types.Object) -> None:
    """Show what there was before the preview, by switches alone: nothing is freed, so that any thread may ask for it."""
    if is_on(obj):
        block, hidden = _block(obj), _hidden(json.loads(obj.data.shape_keys[PREVIEW]))
        block.mute = True
        show_bake(obj.name, hidden)


def unpause(obj: bpy.types.Object) -> None:
    """Undo `pause`."""
    if is_on(obj):
        hide_bake(obj)
        _block(obj).mute = False


def remove(obj: bpy.types.Object) -> bool:
    """Take the key off, and the Basis where it was made for it, and show what was baked before.

    Returns
    -------
    False where there was none.
    """
    key = obj.data.shape_keys if obj.type == "MESH" else None
    if key is None or PREVIEW not in key:
        return False
    record = json.loads(key[PREVIEW])
    with object_mode(obj.name), same_active_key(obj):
        del key[PREVIEW]
        remove_passing_key(obj, record["name"], record["made_basis"])
        show_bake(obj.name, _hidden(record))
        obj.data.update_tag()
    return True


def remove_left_over() -> tuple[str, ...]:
    """Take the key off all meshes of the file that have one; names of their objects."""
    found = [obj.name for obj in bpy.data.objects if obj.type == "MESH" and obj.library is None and _has_record(obj)]
    return tuple(name for name in found if remove(bpy.data.objects[name]))


def _block(obj: bpy.types.Object) -> bpy.types.ShapeKey:
    key = obj.data.shape_keys
    return key.key_blocks[json.loads(key[PREVIEW])["name"]]


def _hidden(record: dict[str, Any]) -> HiddenBake:
    hidden = record["hidden"]
    return HiddenBake(tuple(hidden["muted"]), hidden["absolute"], tuple(hidden["modifiers"]))


def _has_record(obj: bpy.types.Object) -> bool:
    return obj.data.library is None and obj.data.shape_keys is not None and PREVIEW in obj.data.shape_keys
