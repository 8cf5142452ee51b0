# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling a deformation that no formula here knows, by probes.

One is the evaluated mesh, three more have every rest vertex moved a little along an axis; the differences are the
columns of every vertex's Jacobian. The mesh's own coordinates are moved and put back within one call, bit for bit, so
nothing is left behind whenever a bake stops.
"""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender.scene import NotBakeableError
from followthrough.blender.shape_keys import our_names, read_points
from followthrough.character import SampledPose

#: How far a probe moves the vertices, relative to the mesh's size: far enough for float32, near enough for curves.
PROBE = 2e-3


class ProbeReader:
    """Reads where something that is not just bones puts a mesh, and how that changes with its rest vertices.

    Parameters
    ----------
    name
        Of the mesh object.
    vertices
        Their number.
    size
        Of the mesh, in object space.
    """

    def __init__(self, name: str, vertices: int, size: float) -> None:
        self._name = name
        self._vertices = vertices
        self._step = PROBE * size

    def read(self, view_layer: bpy.types.ViewLayer) -> SampledPose:
        """Sample the pose in the scene's current frame."""
        mesh = evaluated(self._name, view_layer)
        world = np.array(mesh.matrix_world, dtype=np.float64)
        positions = self._positions(view_layer)
        shapes = _Shapes(bpy.data.objects[self._name])
        jacobians = np.empty((self._vertices, 3, 3))
        try:
            for axis in range(3):
                shift = np.zeros(3, dtype=np.float32)
                shift[axis] = self._step
                shapes.move(shift)
                view_layer.update()
                jacobians[:, :, axis] = (self._positions(view_layer) - positions) / float(shift[axis])
        finally:
            shapes.put_back()
            view_layer.update()
        return SampledPose(positions=positions, jacobians=jacobians, world=world)

    def _positions(self, view_layer: bpy.types.ViewLayer) -> NDArray[np.float64]:
        mesh = evaluated(self._name, view_layer).data
        if len(mesh.vertices) != self._vertices:
            raise NotBakeableError(
                f"Object '{self._name}' has {len(mesh.vertices)} vertices once deformed, not its own {self._vertices}"
            )
        positions = np.empty(self._vertices * 3, dtype=np.float32)
        mesh.vertices.foreach_get("co", positions)
        return positions.reshape(-1, 3).astype(np.float64)


class _Shapes:
    """Everything of a mesh that says where its rest vertices are."""

    def __init__(self, obj: bpy.types.Object) -> None:
        self._mesh = obj.data
        key = self._mesh.shape_keys
        ours = our_names(key)
        self._blocks = [block for block in key.key_blocks if block.name not in ours] if key is not None else []
        self._saved = [read_points(block) for block in self._blocks]
        if not self._blocks:
            points = np.empty(len(self._mesh.vertices) * 3, dtype=np.float32)
            self._mesh.vertices.foreach_get("co", points)
            self._saved = [points.reshape(-1, 3)]

    def move(self, shift: NDArray[np.float32]) -> None:
        self._write([points + shift for points in self._saved])

    def put_back(self) -> None:
        self._write(self._saved)

    def _write(self, shapes: list[NDArray[np.float32]]) -> None:
        if self._blocks:
            for block, points in zip(self._blocks, shapes, strict=True):
                block.points.foreach_set("co", points.ravel())
            self._mesh.shape_keys.update_tag()
        else:
            self._mesh.vertices.foreach_set("co", shapes[0].ravel())
        self._mesh.update_tag()


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
