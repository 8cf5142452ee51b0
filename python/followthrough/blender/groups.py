# SPDX-License-Identifier: GPL-3.0-or-later
"""The vertex groups that an artist paints: stiffness, mass and pins."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import bpy
import numpy as np

from followthrough.blender.learned_springs import read_learned
from followthrough.blender.modes import object_mode
from followthrough.blender.rig_reading import read_surface, with_skeleton
from followthrough.blender.vertex_weights import VertexWeights, read_weights
from followthrough.character import FloatArray, Paint, Surface
from followthrough.mesh import TetMesh
from followthrough.suggestions import suggest_paint

STIFFNESS_GROUP = "Followthrough Stiffness"
MASS_GROUP = "Followthrough Mass"
PINS_GROUP = "Followthrough Pins"
USUAL_GROUPS = (STIFFNESS_GROUP, MASS_GROUP, PINS_GROUP)


@dataclass(frozen=True)
class PinGroup:
    """A vertex group that pins, and how strongly: its weights are multiplied by `strength` (0 to 1)."""

    name: str
    strength: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.strength <= 1.0:
            raise ValueError(f"pin group {self.name!r}: found strength {self.strength:g}, expected 0 to 1")


@dataclass(frozen=True)
class PaintGroups:
    """Which vertex groups are read.

    Parameters
    ----------
    stiffness, mass
        Group names; None: the usual group where the mesh has it, otherwise `suggest_paint`.
    pins
        Several groups may pin, the strongest wins; None as above. An empty tuple: nothing is pinned.
    """

    stiffness: str | None = None
    mass: str | None = None
    pins: tuple[PinGroup, ...] | None = None


def add_groups(
    obj: bpy.types.Object, surface: Surface | None = None, names: tuple[str, ...] = USUAL_GROUPS
) -> list[str]:
    """Create those of the usual groups that the mesh does not have yet, filled with suggested values.

    Parameters
    ----------
    obj
        A mesh object that can be baked.
    surface
        What `read_surface` gave for it, where the caller has that already.
    names
        Which of the three.

    Returns
    -------
    Names of the groups that were created; groups that were there are not touched.
    """
    missing = [name for name in USUAL_GROUPS if name in names and name not in obj.vertex_groups]
    if not missing:
        return []
    paint = suggested_paint(obj, surface or read_surface(obj))
    values = {STIFFNESS_GROUP: paint.stiffness, MASS_GROUP: paint.mass, PINS_GROUP: paint.pins}
    for name in missing:
        write_group(obj, name, values[name])
    return missing


def remove_groups(obj: bpy.types.Object, names: Iterable[str], active: str = "") -> None:
    """Remove the vertex groups of these names, where they are there.

    The active group stays active; where it is one of them, the one of the name `active` becomes it.
    """
    names = set(names)
    with object_mode(obj.name):
        if obj.vertex_groups.active is not None and obj.vertex_groups.active.name not in names:
            active = obj.vertex_groups.active.name
        for name in names:
            group = obj.vertex_groups.get(name)
            if group is not None:
                obj.vertex_groups.remove(group)
        if obj.vertex_groups:
            obj.vertex_groups.active_index = max(obj.vertex_groups.find(active), 0)


def suggested_paint(obj: bpy.types.Object, surface: Surface, tets: Callable[[], TetMesh] | None = None) -> Paint:
    """`suggest_paint` with the bones of the mesh's armature, also where something else helps to move it."""
    return suggest_paint(surface if surface.rig is not None else with_skeleton(obj, surface), tets)


def read_paint(
    obj: bpy.types.Object,
    surface: Surface,
    groups: PaintGroups | None = None,
    weights: VertexWeights | None = None,
    tets: Callable[[], TetMesh] | None = None,
) -> Paint:
    """Read what is painted, and the springs that were learned.

    Parameters
    ----------
    obj
        The mesh object.
    surface
        What `read_surface` gave for it.
    groups
        Which groups; the usual ones where it is None.
    weights
        What `read_weights` gave for the object, where the caller has that already.
    tets
        As for `suggest_paint`.

    Raises
    ------
    ValueError
        Where a group that is named does not exist.
    """
    groups = groups or PaintGroups()
    stiffness = groups.stiffness or _if_there(obj, STIFFNESS_GROUP)
    mass = groups.mass or _if_there(obj, MASS_GROUP)
    pins = groups.pins
    if pins is None and _if_there(obj, PINS_GROUP):
        pins = (PinGroup(PINS_GROUP),)
    names = [*filter(None, (stiffness, mass)), *(group.name for group in pins or ())]
    painted = _read_groups(obj, names, weights)
    if stiffness is not None and mass is not None and pins is not None:
        nothing = np.zeros(len(surface.rest_positions))
        paint = Paint(nothing, nothing, nothing)  # all of it painted
    else:
        paint = suggested_paint(obj, surface, tets)
    if stiffness is not None:
        paint = replace(paint, stiffness=painted[stiffness])
    if mass is not None:
        paint = replace(paint, mass=painted[mass])
    if pins is not None:
        strengths = [painted[group.name] * group.strength for group in pins]
        paint = replace(paint, pins=np.max([np.zeros(len(surface.rest_positions)), *strengths], axis=0))
    return replace(paint, learned=read_learned(obj))


def write_group(obj: bpy.types.Object, name: str, values: FloatArray) -> None:
    """Set every vertex's weight (v,), 0 to 1, in the group of that name, which is created where it is missing."""
    count = len(obj.data.vertices)
    if values.shape != (count,):
        raise ValueError(f"values: found shape {values.shape}, expected ({count},), one value a vertex")
    with object_mode(obj.name):
        active = obj.vertex_groups.active_index
        group = obj.vertex_groups.get(name)
        if group is None:
            group = obj.vertex_groups.new(name=name)
            obj.vertex_groups.active_index = max(active, 0)
        # One call for all the vertices of one value: most are exactly 0, 1 or neutral.
        order = np.argsort(values, kind="stable")
        starts = np.flatnonzero(np.diff(values[order], prepend=np.nan))
        for indices in np.split(order, starts[1:]):
            group.add(indices.tolist(), float(values[indices[0]]), "REPLACE")


def _if_there(obj: bpy.types.Object, name: str) -> str | None:
    return name if name in obj.vertex_groups else None


def _read_groups(obj: bpy.types.Object, names: Iterable[str], weights: VertexWeights | None) -> dict[str, FloatArray]:
    """Weights (v,) of the named groups, 0 where a vertex is not in one."""
    indices = {}
    for name in dict.fromkeys(names):
        group = obj.vertex_groups.get(name)
        if group is None:
            there = ", ".join(repr(other.name) for other in obj.vertex_groups) or "none"
            raise ValueError(f"Object '{obj.name}' has no vertex group {name!r} (it has {there})")
        indices[name] = group.index
    if not indices:
        return {}
    weights = weights or read_weights(obj)
    return {name: weights.of_group(index) for name, index in indices.items()}
