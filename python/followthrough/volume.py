# SPDX-License-Identifier: GPL-3.0-or-later
"""The simulated volume of a character: tets around its rest pose, with bone weights and painted values on their vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from followthrough import mesh, skinning
from followthrough.character import (
    BonePose,
    FloatArray,
    IntArray,
    LearnedSprings,
    Paint,
    Pose,
    Surface,
    distances_to_segments,
    flesh_thickness,
)
from followthrough.settings import VolumeSettings

#: Painted pins from here up follow the armature exactly.
HARD_PIN = 1.0 - 1e-4


@dataclass(frozen=True)
class Volume:
    """Tets around a character, made once on its rest pose.

    Attributes
    ----------
    tet_mesh : TetMesh
        Vertices (n, 3) in metres at rest, tets (m, 4), and the embedding of the surface's vertices.
    rest_positions : (n, 3) float64
        The same vertices in the mesh's object space, where skinning acts.
    bone_indices : (n, k) int32, bone_weights : (n, k) float64
        Which bones move a vertex of the volume; None where no armature does.
    stiffness, mass, pins : (n,) float64
        Painted values carried to the volume; `pins` includes the core around the bones.
    learned : LearnedSprings or None
        Learned springs carried to the volume, where most of what a vertex is carried by was learned.
    """

    surface: Surface
    tet_mesh: mesh.TetMesh
    rest_positions: FloatArray
    bone_indices: IntArray | None
    bone_weights: FloatArray | None
    follower: mesh.SurfaceFollower | None
    stiffness: FloatArray
    mass: FloatArray
    pins: FloatArray
    learned: LearnedSprings | None = None

    @property
    def pinned(self) -> NDArray[np.bool_]:
        """(n,) bool: vertices that follow the reference exactly."""
        return self.pins >= HARD_PIN

    def reference(self, pose: Pose) -> FloatArray:
        """Where the character's own rig puts the volume's vertices: (n, 3) in the world, metres."""
        if isinstance(pose, BonePose):
            rig = self.surface.rig
            if rig is None or self.bone_indices is None or self.bone_weights is None:
                raise ValueError(
                    "pose: found bone matrices, but this volume was made without a rig; expected a SampledPose"
                )
            local = skinning.pose_vertices(
                self.rest_positions,
                self.bone_indices,
                self.bone_weights,
                pose.bone_matrices,
                rig.skinning,
                rig.bone_rest_matrices,
                pose.armature,
            )
        else:
            if self.follower is None:
                raise ValueError(
                    "pose: found sampled positions, but this volume follows an armature; expected a BonePose"
                )
            local = self.follower(pose.positions)
        return _transformed(local, pose.world)

    def surface_displacements(self, dynamic: FloatArray, reference: FloatArray) -> FloatArray:
        """Displacement of the surface's vertices (v, 3) by the volume's (n, 3), both in the world, metres."""
        return mesh.interpolate(
            dynamic - reference, self.tet_mesh.tets, self.tet_mesh.embedding_tets, self.tet_mesh.embedding_weights
        )


def make_tets(surface: Surface, settings: VolumeSettings) -> mesh.TetMesh:
    """The tets of a character's volume; neither its rig nor what is painted has a say in them.

    Raises
    ------
    ValueError
        Where the surface is empty or not finite.
    """
    return mesh.tetrahedralize(
        surface.rest_positions @ surface.object_scale.T,
        surface.triangles,
        cells=settings.cells,
        split_parts=settings.split_parts,
        method=settings.method,
    )


def build_volume(
    surface: Surface, paint: Paint, settings: VolumeSettings | None = None, tet_mesh: mesh.TetMesh | None = None
) -> Volume:
    """Make the volume of a character.

    Parameters
    ----------
    surface
        The character at rest.
    paint
        Painted values of its vertices.
    settings
        Size and method.
    tet_mesh
        What `make_tets` gave for this surface and these settings, where the caller has that already.

    Raises
    ------
    ValueError
        Where the surface is empty, not finite or its arrays do not fit each other, naming the array.
    """
    settings = settings or VolumeSettings()
    count = len(surface.rest_positions)
    for name in ("stiffness", "mass", "pins"):
        values = getattr(paint, name)
        if values.shape != (count,):
            raise ValueError(
                f"paint.{name}: found shape {values.shape}, expected ({count},), one value a surface vertex"
            )
    if paint.learned is not None and paint.learned.stiffness.shape != (count,):
        raise ValueError(
            f"paint.learned: found shape {paint.learned.stiffness.shape}, expected ({count},), one value a surface vertex"
        )
    metres = surface.rest_positions @ surface.object_scale.T
    if tet_mesh is None:
        tet_mesh = make_tets(surface, settings)
    transfer = mesh.SurfaceTransfer(metres, surface.triangles, tet_mesh)
    painted = np.clip(transfer(np.column_stack([paint.stiffness, paint.mass, paint.pins])), 0.0, 1.0)
    stiffness, mass, pins = painted.T.copy()

    # A pinned vertex of the surface follows exactly only where every corner that carries it does.
    corners = tet_mesh.tets[tet_mesh.embedding_tets]
    pins[np.unique(corners[paint.pins >= HARD_PIN])] = 1.0

    bone_indices = bone_weights = follower = None
    if surface.rig is not None:
        bone_indices, bone_weights = skinning.transfer_bone_weights(
            transfer, surface.rig.bone_indices, surface.rig.bone_weights, len(surface.rig.bone_segments)
        )
        radius = settings.core_radius * flesh_thickness(surface)
        if radius > 0:
            # Inside the flesh the bones hold; where the surface hangs on a vertex, the painted group decides.
            inside = np.ones(len(tet_mesh.vertices), dtype=bool)
            inside[np.unique(corners)] = False
            segments = surface.rig.holding_segments @ surface.object_scale.T
            pins[inside & (distances_to_segments(tet_mesh.vertices, segments) <= radius)] = 1.0
    else:
        follower = mesh.SurfaceFollower(surface.rest_positions, surface.triangles, tet_mesh, surface.object_scale)
    return Volume(
        surface=surface,
        tet_mesh=tet_mesh,
        rest_positions=tet_mesh.vertices @ np.linalg.inv(surface.object_scale).T,
        bone_indices=bone_indices,
        bone_weights=bone_weights,
        follower=follower,
        stiffness=stiffness,
        mass=mass,
        pins=pins,
        learned=None if paint.learned is None else _carried(paint.learned, transfer),
    )


def _carried(learned: LearnedSprings, transfer: mesh.SurfaceTransfer) -> LearnedSprings | None:
    """Learned springs on the volume: means of logarithms over what is known; None where that is nothing."""
    known = learned.known
    if not known.any():
        return None
    logarithms = np.zeros((len(known), 4))
    logarithms[known, 0] = 1.0
    for column, values in enumerate((learned.stiffness, learned.damping, learned.painted_stiffness), 1):
        logarithms[known, column] = np.log(values[known])
    carried = transfer(logarithms)
    there = carried[:, 0] > 0.5
    share = np.where(there, carried[:, 0], 1.0)[:, None]
    stiffness, damping, painted = np.where(there[:, None], np.exp(carried[:, 1:] / share), 0.0).T.copy()
    return LearnedSprings(stiffness, damping, painted, learned.damping_ratio)


def _transformed(points: FloatArray, matrix: FloatArray) -> FloatArray:
    moved: FloatArray = points @ matrix[:3, :3].T + matrix[:3, 3]
    return moved
