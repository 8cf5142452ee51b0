# SPDX-License-Identifier: GPL-3.0-or-later
"""Vertex groups as arrays, by either way of reading them."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender.vertex_weights import read_weights

COUNT = 50


@pytest.fixture(params=[False, True], ids=["plain", "with keys"])
def mesh(request):
    """A row of vertices, some in several groups, some in none."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    data = bpy.data.meshes.new("Row")
    data.from_pydata([(float(i), 0.0, 0.0) for i in range(COUNT)], [(i, i + 1) for i in range(COUNT - 1)], [])
    obj = bpy.data.objects.new("Row", data)
    bpy.context.scene.collection.objects.link(obj)
    if request.param:
        obj.shape_key_add(name="Basis")
        obj.shape_key_add(name="Other").points[3].co.x = 7.0
    return obj


def test_every_weight_above_zero_is_read_in_the_vertices_order(mesh):
    generator = np.random.default_rng(4)
    groups = [mesh.vertex_groups.new(name=name) for name in "ABCD"]
    expected = np.zeros((COUNT, 4))
    written = []
    for vertex in range(0, COUNT, 2):
        for group in generator.permutation(4)[: generator.integers(0, 4)].tolist():
            weight = float(np.float32(generator.choice([0.0, 0.25, generator.random()])))
            groups[group].add([vertex], weight, "REPLACE")
            expected[vertex, group] = weight
            written += [(vertex, group)] if weight else []
    found = read_weights(mesh)
    assert list(zip(found.vertices.tolist(), found.groups.tolist(), strict=True)) == written
    assert found.vertex_count == COUNT
    for group in range(4):
        np.testing.assert_array_equal(found.of_group(group), expected[:, group])
    indices, weights = found.table({0: 10, 2: 11})
    assert weights.sum() == expected[:, [0, 2]].sum()
    assert set(indices[weights > 0].tolist()) == {10, 11}
    assert [key.name for key in bpy.data.meshes] == ["Row"]


def test_without_groups_there_is_nothing(mesh):
    found = read_weights(mesh)
    assert found.vertex_count == COUNT
    assert len(found.weights) == len(found.groups) == len(found.vertices) == 0
    assert not found.of_group(0).any()
