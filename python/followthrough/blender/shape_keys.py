# SPDX-License-Identifier: GPL-3.0-or-later
"""Our shape keys on a mesh: one a frame, relative or absolute, animated by an action of their own.

Keys and animation of others are never touched.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NotRequired, TypedDict

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender import actions
from followthrough.blender.modes import object_mode

#: Custom property of the Key data-block that says what is ours.
RECORD = "followthrough"
#: Another one, which says which key shows a live preview, and how it goes away.
PREVIEW = "followthrough_preview"

#: From one absolute key to the next: Blender's own distance.
_KEY_DISTANCE = 10.0


class _Record(TypedDict):
    start: int
    end: int
    names: list[str]
    basis: bool
    absolute: NotRequired[bool]


def write(
    obj: bpy.types.Object,
    frames: Sequence[int],
    offsets: NDArray[np.float32],
    frame_length: float = 1.0,
    absolute: bool = False,
) -> None:
    """Replace our shape keys on this mesh.

    Parameters
    ----------
    frames
        Scene frames, ascending and without gaps.
    offsets : (frames, v, 3) float32
        What each key adds to the Basis, in object space.
    frame_length
        `actions.frame_length` of the scene that plays them.
    absolute
        One curve, of the evaluation time, runs through keys that stand in a row, the Basis before and a key of rest after them. Only
        where the mesh has no other keys.

    Raises
    ------
    ValueError
        Where the shape does not fit the mesh; nothing is changed then.
    """
    expected = (len(frames), len(obj.data.vertices), 3)
    if offsets.shape != expected or not len(frames):
        raise ValueError(f"offsets: found shape {offsets.shape}, expected {expected}, at least one frame")
    with object_mode(obj.name), same_active_key(obj):
        made_basis = _remove(obj, keep_basis=True) or obj.data.shape_keys is None
        if obj.data.shape_keys is None:
            obj.shape_key_add(name="Basis", from_mix=False)
        key = obj.data.shape_keys
        basis = read_points(key.reference_key)
        names: list[str] = []
        points = np.empty_like(basis)
        if absolute:
            key.use_relative = False
            key.reference_key.interpolation = "KEY_LINEAR"
        for frame, offset in zip(frames, offsets, strict=True):
            if absolute:
                key.eval_time = _KEY_DISTANCE * (len(names) + 1)  # where the key is put
            block = obj.shape_key_add(name=f"Followthrough {frame:04d}", from_mix=False)
            block.relative_key = key.reference_key
            block.value = 0.0
            if absolute:
                block.interpolation = "KEY_LINEAR"
            block.points.foreach_set("co", np.add(basis, offset, out=points).ravel())
            names.append(block.name)
        if absolute:
            key.eval_time = end = _KEY_DISTANCE * (len(names) + 1)
            block = obj.shape_key_add(name="Followthrough Rest", from_mix=False)
            block.interpolation, block.value = "KEY_LINEAR", 0.0
            block.points.foreach_set("co", basis.ravel())
            names.append(block.name)
            curves = [actions.Curve("eval_time", (frames[0] - 1, frames[-1] + 1), (0.0, end))]
        else:
            curves = actions.relative_curves(frames, names)
        record: _Record = {
            "start": int(frames[0]),
            "end": int(frames[-1]),
            "names": names,
            "basis": made_basis,
            "absolute": absolute,
        }
        key[RECORD] = json.dumps(record)
        actions.write_action(key, f"{actions.OURS} {obj.name}", curves, frame_length)
        obj.data.update_tag()


def clear(obj: bpy.types.Object) -> bool:
    """Remove exactly what a bake made on this mesh: keys, action, and the Basis where we made it and no other is left.

    Returns
    -------
    False where there was nothing to remove.
    """
    if obj.type != "MESH" or obj.data.shape_keys is None or RECORD not in obj.data.shape_keys:
        return False
    with object_mode(obj.name), same_active_key(obj):
        _remove(obj, keep_basis=False)
        obj.data.update_tag()
    return True


def baked_range(obj: bpy.types.Object) -> tuple[int, int] | None:
    """First and last frame of the bake that this mesh carries; None where it carries none."""
    record = _record(obj.data.shape_keys) if obj.type == "MESH" else None
    return (record["start"], record["end"]) if record is not None else None


def our_names(key: bpy.types.Key | None) -> frozenset[str]:
    """Names of the shape keys that a bake made, also of those that someone has renamed since."""
    record = _record(key)
    if key is None or record is None:
        return frozenset()
    return frozenset(record["names"]) & frozenset(key.key_blocks.keys()) | actions.animated_blocks(key)


def passing_names(key: bpy.types.Key | None) -> frozenset[str]:
    """Names of the shape keys that do not count as the mesh's own: those of a bake, and the one that shows a live preview."""
    ours = our_names(key)
    if key is None or PREVIEW not in key:
        return ours
    return ours | {json.loads(key[PREVIEW])["name"]}


def is_absolute_bake(key: bpy.types.Key | None) -> bool:
    """Whether the shape keys are absolute because a bake made them so."""
    record = _record(key)
    return key is not None and record is not None and record.get("absolute", False) and not key.use_relative


class TrialKey:
    """A shape key that shows offsets before they are baked; `remove` leaves the mesh as it was."""

    def __init__(self, name: str) -> None:
        self._object = name
        obj = bpy.data.objects[name]
        with same_active_key(obj):
            self._name, self._made_basis = add_passing_key(obj, "Followthrough Trial")
        self._basis = read_points(obj.data.shape_keys.reference_key)

    def show(self, offsets: NDArray[np.float64]) -> None:
        """Add these offsets (v, 3), object space, to what the other shape keys show."""
        show_points(bpy.data.objects[self._object].data, self._name, self._basis + offsets.astype(np.float32))

    def hide(self) -> None:
        """Add nothing again."""
        obj = bpy.data.objects.get(self._object)
        if obj is not None and self._is_on(obj.data):
            show_points(obj.data, self._name, self._basis)

    def remove(self) -> None:
        """Take the key away, and the Basis where it was made for it."""
        obj = bpy.data.objects.get(self._object)
        if obj is None or not self._is_on(obj.data):
            return
        with object_mode(obj.name), same_active_key(obj):
            remove_passing_key(obj, self._name, self._made_basis)

    def _is_on(self, mesh: bpy.types.Mesh) -> bool:
        return mesh.shape_keys is not None and self._name in mesh.shape_keys.key_blocks


def add_passing_key(obj: bpy.types.Object, name: str) -> tuple[str, bool]:
    """Give a mesh one more key, which shows the Basis at first; its name, and whether the Basis had to be made for it."""
    made_basis = obj.data.shape_keys is None
    if made_basis:
        obj.shape_key_add(name="Basis", from_mix=False)
    block = obj.shape_key_add(name=name, from_mix=False)
    block.relative_key = obj.data.shape_keys.reference_key
    block.value = 1.0
    return block.name, made_basis


def remove_passing_key(obj: bpy.types.Object, name: str, made_basis: bool) -> None:
    """Take it away where it is there, and the Basis where that was made for it and nothing else needs it."""
    key = obj.data.shape_keys
    if name in key.key_blocks:
        obj.shape_key_remove(key.key_blocks[name])
    if made_basis and len(key.key_blocks) == 1:
        obj.shape_key_remove(key.key_blocks[0])


def show_points(mesh: bpy.types.Mesh, name: str, points: NDArray[np.float32]) -> None:
    """Move a key's points, (v, 3)."""
    mesh.shape_keys.key_blocks[name].points.foreach_set("co", points.ravel())
    mesh.shape_keys.update_tag()
    mesh.update_tag()


def read_points(block: bpy.types.ShapeKey) -> NDArray[np.float32]:
    """Coordinates of a shape key, (v, 3)."""
    points = np.empty(len(block.points) * 3, dtype=np.float32)
    block.points.foreach_get("co", points)
    return points.reshape(-1, 3)


def _record(key: bpy.types.Key | None) -> _Record | None:
    if key is None or RECORD not in key:
        return None
    record: _Record = json.loads(key[RECORD])
    return record


def _remove(obj: bpy.types.Object, keep_basis: bool) -> bool:
    """Remove our keys and action; returns whether the Basis that is left is one that we made."""
    key = obj.data.shape_keys
    record = _record(key)
    if key is None or record is None:
        return False
    names = our_names(key)
    if is_absolute_bake(key):
        key.use_relative = True
        key.eval_time = 0.0
    actions.remove_action(key)
    for block in reversed([block for block in key.key_blocks if block.name in names]):
        obj.shape_key_remove(block)
    del key[RECORD]
    if record["basis"] and not keep_basis and len(key.key_blocks) == 1:
        obj.shape_key_remove(key.key_blocks[0])
        return False
    return record["basis"]


@contextmanager
def same_active_key(obj: bpy.types.Object) -> Iterator[None]:
    """Keep the active shape key active, wherever in the list it is afterwards."""
    active = obj.active_shape_key.name if obj.active_shape_key is not None else None
    yield
    key = obj.data.shape_keys
    if key is not None:
        obj.active_shape_key_index = max(key.key_blocks.find(active), 0) if active is not None else 0
