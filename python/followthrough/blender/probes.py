# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that something else than bones moves: where Blender puts them, and which offsets at rest show a displacement.

While such a mesh is baked it has a shape key more, which stands for the one that is to be baked: the offsets that
`followthrough.offset_search` tries are written to it, and Blender evaluates the mesh. What is found is therefore exact,
whatever the modifiers are.
"""

from __future__ import annotations

import math

import bpy
import numpy as np

from followthrough.affine import determinant
from followthrough.blender.scene import NotBakeableError
from followthrough.blender.shape_keys import TrialKey
from followthrough.character import FloatArray, SampledPose
from followthrough.offset_search import Deform, FoundOffsets, OffsetSearch

#: How far a probe moves the vertices, relative to the mesh's size: far enough for float32, near enough for curves.
PROBE = 2e-3
#: Largest residual that a search leaves, relative to the mesh's size, where it can.
TOLERANCE = 1e-5
#: Rounding of a coordinate by Blender's modifiers, relative to the largest one.
ROUNDING = 5e-7
#: Least stretch of an object along an axis, relative to its largest.
FLAT = 1e-6
#: Share of vertices that shape keys do not move from which on a mesh is not worth a bake.
STUCK = 0.99


class SampleReader:
    """Reads where Blender's modifiers put a mesh.

    Parameters
    ----------
    name
        Of the mesh object.
    vertices
        Their number.
    """

    def __init__(self, name: str, vertices: int) -> None:
        self._name = name
        self._vertices = vertices

    def read(self, view_layer: bpy.types.ViewLayer) -> SampledPose:
        """Read the pose in the scene's current frame."""
        world = world_matrix(evaluated(self._name, view_layer))
        return SampledPose(positions=self.positions(view_layer), world=world)

    def positions(self, view_layer: bpy.types.ViewLayer) -> FloatArray:
        """Deformed vertices (v, 3) in object space."""
        mesh = evaluated(self._name, view_layer).data
        if len(mesh.vertices) != self._vertices:
            raise NotBakeableError(
                f"Object '{self._name}' has {len(mesh.vertices)} vertices once deformed, not its own {self._vertices}"
            )
        positions = np.empty(self._vertices * 3, dtype=np.float32)
        mesh.vertices.foreach_get("co", positions)
        return positions.reshape(-1, 3).astype(np.float64)


class OffsetFinder:
    """Finds what a shape key must add so that a mesh shows a displacement in the scene's current frame.

    Parameters
    ----------
    name
        Of the mesh object.
    rest_positions : (v, 3) float64
        Its Basis.
    minimum_stretch
        As in `OffsetSearch`.
    """

    def __init__(self, name: str, rest_positions: FloatArray, minimum_stretch: float) -> None:
        self._name = name
        self._reader = SampleReader(name, len(rest_positions))
        self._key = TrialKey(name)
        size = float(np.ptp(rest_positions, axis=0).max())
        rounding = ROUNDING * float(np.abs(rest_positions).max())
        self._minimum_stretch = minimum_stretch
        self._search = OffsetSearch(len(rest_positions), max(TOLERANCE * size, rounding), PROBE * size, minimum_stretch)

    def find(self, view_layer: bpy.types.ViewLayer, displacements: FloatArray) -> FoundOffsets:
        """Offsets that show the displacements (v, 3), in object space; the mesh is left as it was."""

        try:
            return self._search.find(self._deformed_by(view_layer), displacements)
        finally:
            self._key.hide()

    def require_effect(self, view_layer: bpy.types.ViewLayer) -> None:
        """Check that shape keys can move the mesh at all.

        Raises
        ------
        NotBakeableError
            Where modifiers put nearly every vertex where they want, wherever it is at rest.
        """
        try:
            jacobians = self._search.measure(self._deformed_by(view_layer))
        finally:
            self._key.hide()
        stretches = np.linalg.svd(jacobians, compute_uv=False)
        stuck = float(np.mean(stretches[:, 0] < self._minimum_stretch))
        if stuck > STUCK:
            raise NotBakeableError(
                f"Object '{self._name}' has modifiers that put its vertices in place whatever its shape keys do (such as "
                "Surface Deform or Shrinkwrap): bake the mesh that it follows"
            )

    def _deformed_by(self, view_layer: bpy.types.ViewLayer) -> Deform:
        def deform(offsets: FloatArray) -> FloatArray:
            self._key.show(offsets)
            view_layer.update()
            return self._reader.positions(view_layer)

        return deform

    def remove(self) -> None:
        """Take the shape key back."""
        self._key.remove()


def world_matrix(obj: bpy.types.Object) -> FloatArray:
    """From the object's space to the world, (4, 4).

    Raises
    ------
    NotBakeableError
        Where it flattens the object, so that nothing leads back.
    """
    matrix = np.array(obj.matrix_world, dtype=np.float64)
    # The smallest stretch is 2 |determinant| / |matrix|² or more: proof, nearly always, that nothing is flat.
    linear = matrix[:3, :3]
    size = math.sqrt(float(np.vdot(linear, linear)))
    if 2.0 * abs(determinant(linear)) > FLAT * size**3:
        return matrix
    stretches = np.linalg.svd(linear, compute_uv=False) if np.isfinite(matrix).all() else np.ones(3)
    if not stretches.min() > FLAT * stretches.max():
        raise NotBakeableError(f"Object '{obj.name}' is flat: its scale is 0 along some axis, or nearly so")
    return matrix


def evaluated(name: str, view_layer: bpy.types.ViewLayer) -> bpy.types.Object:
    """The object as the view layer evaluates it, fetched by name.

    Raises
    ------
    NotBakeableError
        Where it is gone.
    """
    obj = bpy.data.objects.get(name)
    if obj is None:
        raise NotBakeableError(f"Object '{name}' is no longer there")
    return obj.evaluated_get(view_layer.depsgraph)
