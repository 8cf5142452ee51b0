# SPDX-License-Identifier: GPL-3.0-or-later
"""A mesh's vertex groups as arrays. Blender has them vertex by vertex only, and hands a vertex's over at once in a BMesh alone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any

import bmesh
import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray, IntArray


@dataclass(frozen=True)
class VertexWeights:
    """Every weight above 0, in the order in which the vertices store them; (e,) each."""

    vertices: NDArray[np.intp]
    groups: NDArray[np.intp]
    weights: FloatArray
    vertex_count: int

    def of_group(self, group: int) -> FloatArray:
        """Weights (v,) in one group, 0 where a vertex is not in it."""
        found = np.zeros(self.vertex_count)
        chosen = self.groups == group
        found[self.vertices[chosen]] = self.weights[chosen]
        return found

    def table(self, bone_of_group: dict[int, int]) -> tuple[IntArray, FloatArray]:
        """Table (v, k) of bones and of weights, of those groups that stand for a bone; unused places have weight 0."""
        bones = np.full(max(max(bone_of_group, default=0), int(self.groups.max(initial=0))) + 1, -1)
        bones[list(bone_of_group)] = list(bone_of_group.values())
        chosen = bones[self.groups] >= 0
        vertices = self.vertices[chosen]
        counts = np.bincount(vertices, minlength=self.vertex_count)
        place = (
            np.arange(len(vertices)) - (np.cumsum(counts) - counts)[vertices]
        )  # a vertex's elements follow each other
        width = int(place.max(initial=0)) + 1
        indices = np.zeros((self.vertex_count, width), dtype=np.int32)
        weights = np.zeros((self.vertex_count, width))
        indices[vertices, place] = bones[self.groups[chosen]]
        weights[vertices, place] = self.weights[chosen]
        return indices, weights


def read_weights(obj: bpy.types.Object) -> VertexWeights:
    """Read all vertex groups of a mesh object that is not in Edit Mode."""
    # A BMesh would read all shape keys, too, which takes longer than what it saves.
    mesh = obj.data
    counts, groups, weights = _read_elements(mesh) if mesh.shape_keys is not None else _read_vertices(mesh)
    used = weights > 0.0
    return VertexWeights(
        vertices=np.repeat(np.arange(len(counts)), counts)[used],
        groups=groups[used],
        weights=weights[used],
        vertex_count=len(counts),
    )


#: How many elements each vertex has, and the group and weight of each.
_Elements = tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]


def _read_vertices(mesh: bpy.types.Mesh) -> _Elements:
    bm = bmesh.new(use_operators=False)
    try:
        bm.from_mesh(mesh, face_normals=False, vertex_normals=False)
        layer = bm.verts.layers.deform.verify()
        rows: list[Any] = [vertex[layer] for vertex in bm.verts]
        counts = np.fromiter(map(len, rows), dtype=np.intp, count=len(rows))
        groups = np.fromiter(chain.from_iterable(row.keys() for row in rows), dtype=np.intp, count=counts.sum())
        weights = np.fromiter(chain.from_iterable(row.values() for row in rows), dtype=np.float64, count=counts.sum())
    finally:
        bm.free()
    return counts, groups, weights


def _read_elements(mesh: bpy.types.Mesh) -> _Elements:
    # Blender hands out one object an element; all that can be saved is what Python would do with each.
    rows: list[Any] = list(map(attrgetter("groups"), mesh.vertices))
    counts = np.fromiter(map(len, rows), dtype=np.intp, count=len(rows))
    elements: list[Any] = list(chain.from_iterable(rows))
    groups = np.fromiter(map(attrgetter("group"), elements), dtype=np.intp, count=len(elements))
    weights = np.fromiter(map(attrgetter("weight"), elements), dtype=np.float64, count=len(elements))
    return counts, groups, weights
