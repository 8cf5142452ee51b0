# SPDX-License-Identifier: GPL-3.0-or-later
"""A skinned character as plain arrays: its surface at rest, what is painted on it, and its pose in one frame. No Blender here."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Skinning = Literal["linear", "dual-quaternion"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class Rig:
    """What an armature does to a mesh's vertices, as Blender's Armature modifier does it.

    Parameters
    ----------
    bone_indices : (v, k) int32
        Bones that move a vertex; unused places have weight 0.
    bone_weights : (v, k) float64
        Their weights, as painted (not normalised). A vertex without weights is not moved by the armature.
    bone_segments : (b, 2, 3) float64
        Head and tail of every bone at rest, in the mesh's object space.
    skinning
        "dual-quaternion" where the modifier preserves volume.
    bone_rest_matrices : (b, 4, 4) float64 or None
        From a bone's own axes to the armature's space at rest (`Bone.matrix_local`). Dual quaternions need them where
        bones are scaled unevenly.
    bone_names
        What the bones are called, where that is known.
    skeleton : (s, 2, 3) float64 or None
        Lines in the mesh's object space along which the flesh is held, where they are not the bones' own segments: imported
        bones often point elsewhere than to the next joint. None: `bone_segments`.
    """

    bone_indices: IntArray
    bone_weights: FloatArray
    bone_segments: FloatArray
    skinning: Skinning = "linear"
    bone_rest_matrices: FloatArray | None = None
    bone_names: tuple[str, ...] = ()
    skeleton: FloatArray | None = None

    @property
    def holding_segments(self) -> FloatArray:
        """(s, 2, 3): `skeleton`, or the bones' own segments."""
        return self.bone_segments if self.skeleton is None else self.skeleton


@dataclass(frozen=True)
class Surface:
    """A character's mesh at rest.

    Parameters
    ----------
    rest_positions : (v, 3) float64
        Vertices in the mesh's object space (the Basis shape).
    triangles : (t, 3) int32
    object_scale : (3, 3) float64
        Symmetric stretch from object space to the world (the polar factor of the object's matrix, times the scale that all
        bones share), so that cells are cubes in the world, in metres.
    rig : Rig or None
        None where something other than an armature moves the mesh; poses are then `SampledPose`.
    character_size : float or None
        Longest side at rest, metres in the world, of the character that this mesh is a part of (a jacket on a body); None:
        of this mesh alone.
    """

    rest_positions: FloatArray
    triangles: IntArray
    object_scale: FloatArray = field(default_factory=lambda: np.eye(3))
    rig: Rig | None = None
    character_size: float | None = None

    @property
    def size(self) -> float:
        """`character_size`, or this mesh's own longest side: what lengths of the character are measured by, metres."""
        if self.character_size is not None:
            return self.character_size
        return float(np.ptp(self.rest_positions @ self.object_scale.T, axis=0).max())

    @cached_property
    def bone_distances(self) -> FloatArray:
        """Distance (v,) of every vertex at rest to the nearest of the bones, metres; infinite where there are none."""
        if self.rig is None:
            return np.full(len(self.rest_positions), np.inf)
        scale = self.object_scale.T
        return distances_to_segments(self.rest_positions @ scale, self.rig.holding_segments @ scale)


@dataclass(frozen=True)
class LearnedSprings:
    """Spring constants that were learned from a simulation (`followthrough.spring_fit`), one a vertex.

    Parameters
    ----------
    stiffness, damping : (v,) float64
        ks, 1/s², and kd, 1/s; 0 where nothing was learned.
    painted_stiffness : (v,) float64
        ks, 1/s², that paint and settings gave when they were learned: what is painted or set otherwise since then scales them.
    damping_ratio
        Of the settings at that time.
    """

    stiffness: FloatArray
    damping: FloatArray
    painted_stiffness: FloatArray
    damping_ratio: float

    @property
    def known(self) -> NDArray[np.bool_]:
        """(v,) bool: where something was learned."""
        known: NDArray[np.bool_] = (self.stiffness > 0) & (self.damping > 0) & (self.painted_stiffness > 0)
        return known


@dataclass(frozen=True)
class Paint:
    """What an artist painted, one value from 0 to 1 a surface vertex; (v,) float64 each.

    `stiffness` 0 is the softest and 1 the stiffest, `mass` 0 the lightest and 1 the heaviest (0.5 is neutral), `pins` 0 free, 1 follows
    the armature exactly, and anything between is a soft pin. `learned` are springs that take the place of painted ones.
    """

    stiffness: FloatArray
    mass: FloatArray
    pins: FloatArray
    learned: LearnedSprings | None = None


@dataclass(frozen=True)
class BonePose:
    """One frame of an armature.

    Parameters
    ----------
    bone_matrices : (b, 4, 4) float64
        From the mesh's object space at rest to the same space posed, one a bone of the `Rig`.
    world : (4, 4) float64
        From the mesh's object space to the world.
    armature : (4, 4) float64 or None
        From the armature's space to the mesh's object space: the inverse of the mesh's world matrix times the
        armature's. Dual quaternions need it where one of the two objects is scaled unevenly.

    See `followthrough.skinning` for how these follow from Blender's matrices.
    """

    bone_matrices: FloatArray
    world: FloatArray
    armature: FloatArray | None = None


@dataclass(frozen=True)
class SampledPose:
    """One frame of a mesh that anything may move.

    Parameters
    ----------
    positions : (v, 3) float64
        Deformed vertices in object space.
    world : (4, 4) float64
        From the mesh's object space to the world.
    """

    positions: FloatArray
    world: FloatArray


Pose = BonePose | SampledPose


def distances_to_segments(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Distance of every point to the nearest of the segments.

    Parameters
    ----------
    points : (p, 3) float64
    segments : (b, 2, 3) float64

    Returns
    -------
    (p,) float64, infinite where there is no segment.
    """
    columns = np.ascontiguousarray(points.T)
    nearest = np.full(len(points), np.inf)
    for head, tail in segments:
        along = tail - head
        length_squared = float(along @ along)
        away = columns - head[:, None]
        if length_squared > 0:
            away -= along[:, None] * np.clip((along / length_squared) @ away, 0.0, 1.0)
        np.minimum(nearest, np.einsum("ij,ij->j", away, away), out=nearest)
    distances: FloatArray = np.sqrt(nearest)
    return distances


def flesh_thickness(surface: Surface) -> float:
    """The character's usual distance from bone to skin where it is thickest: the 95th percentile over the surface, metres at rest.

    0 where there is no armature.
    """
    if surface.rig is None or not len(surface.rig.holding_segments):
        return 0.0
    return float(np.percentile(surface.bone_distances, 95))
