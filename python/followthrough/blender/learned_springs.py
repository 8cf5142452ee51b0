# SPDX-License-Identifier: GPL-3.0-or-later
"""Learned spring constants as attributes of the mesh, so that they are saved with the file and follow when it is edited."""

from __future__ import annotations

import bpy
import numpy as np

from followthrough.blender.modes import object_mode
from followthrough.character import FloatArray, LearnedSprings

#: Attributes of the vertices: ks, 1/s², kd, 1/s, and the ks that was painted when they were learned. 0 where nothing was learned.
STIFFNESS_ATTRIBUTE = "Followthrough ks"
DAMPING_ATTRIBUTE = "Followthrough kd"
PAINTED_ATTRIBUTE = "Followthrough ks painted"
_ATTRIBUTES = (STIFFNESS_ATTRIBUTE, DAMPING_ATTRIBUTE, PAINTED_ATTRIBUTE)
#: Property of the mesh: the damping ratio that was set then.
_DAMPING_RATIO = "followthrough_damping_ratio"


def has_learned(obj: bpy.types.Object) -> bool:
    """Whether springs were learned on this mesh; quick enough for a panel."""
    return all(_is_ours(obj.data, name) for name in _ATTRIBUTES)


def read_learned(obj: bpy.types.Object) -> LearnedSprings | None:
    """Read them; None where nothing was learned. Numbers that cannot be a spring's count as not learned."""
    if not has_learned(obj):
        return None
    with object_mode(obj.name):
        columns = []
        for name in _ATTRIBUTES:
            values = np.zeros(len(obj.data.vertices), dtype=np.float32)
            obj.data.attributes[name].data.foreach_get("value", values)
            columns.append(values.astype(np.float64))
    sound = np.all([np.isfinite(values) & (values > 0) for values in columns], axis=0)
    stiffness, damping, painted = (np.where(sound, values, 0.0) for values in columns)
    ratio = obj.data.get(_DAMPING_RATIO, 0.0)
    return LearnedSprings(stiffness, damping, painted, float(ratio) if isinstance(ratio, int | float) else 0.0)


def write_learned(obj: bpy.types.Object, learned: LearnedSprings) -> None:
    """Write them, in the place of earlier ones."""
    with object_mode(obj.name):
        known = learned.known
        columns = (learned.stiffness, learned.damping, learned.painted_stiffness)
        for name, values in zip(_ATTRIBUTES, columns, strict=True):
            _write(obj.data, name, np.where(known, values, 0.0))
        obj.data[_DAMPING_RATIO] = learned.damping_ratio
        obj.data.update()


def remove_learned(obj: bpy.types.Object) -> bool:
    """Remove them; whether there were any."""
    found = False
    with object_mode(obj.name):
        for name in _ATTRIBUTES:
            if name in obj.data.attributes:
                obj.data.attributes.remove(obj.data.attributes[name])
                found = True
        if _DAMPING_RATIO in obj.data:
            del obj.data[_DAMPING_RATIO]
    return found


def _is_ours(mesh: bpy.types.Mesh, name: str) -> bool:
    attribute = mesh.attributes.get(name)
    return attribute is not None and attribute.domain == "POINT" and attribute.data_type == "FLOAT"


def _write(mesh: bpy.types.Mesh, name: str, values: FloatArray) -> None:
    if name in mesh.attributes and not _is_ours(mesh, name):
        mesh.attributes.remove(mesh.attributes[name])
    attribute = mesh.attributes.get(name) or mesh.attributes.new(name, "FLOAT", "POINT")
    attribute.data.foreach_set("value", values.astype(np.float32))
