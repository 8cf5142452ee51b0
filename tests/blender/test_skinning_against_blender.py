# SPDX-License-Identifier: GPL-3.0-or-later
"""Our posing and inverse skinning against what Blender's Armature modifier really does."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import bpy
import numpy as np
import pytest
from mathutils import Euler, Matrix, Quaternion, Vector

from followthrough import skinning

BONES = 5
SCALES = {
    "no scale": lambda rng: (1.0, 1.0, 1.0),
    "even scale": lambda rng: (float(rng.uniform(0.5, 2.0)),) * 3,
    "uneven scale": lambda rng: tuple(rng.uniform(0.4, 2.0, 3)),
    "mirrored": lambda rng: (-1.0, 1.2, 0.8),
}
OBJECTS = {
    "same place": (Matrix(), Matrix()),
    "moved apart": (
        Matrix.LocRotScale(Vector((1, -2, 0.5)), Euler((0.3, 1.1, -0.7)), Vector((1.5, 1.5, 1.5))),
        Matrix.LocRotScale(Vector((-0.5, 0.2, 3)), Euler((-1.2, 0.4, 2.0)), Vector((0.7, 0.7, 0.7))),
    ),
    "unevenly scaled": (
        Matrix.LocRotScale(Vector((1, -2, 0.5)), Euler((0.3, 1.1, -0.7)), Vector((1.5, 0.6, 1.0))),
        Matrix.LocRotScale(Vector((-0.5, 0.2, 3)), Euler((-1.2, 0.4, 2.0)), Vector((0.7, 1.3, 2.0))),
    ),
    "mirrored mesh": (Matrix(), Matrix.LocRotScale(Vector((0.1, 0.2, 0.3)), Euler((0.5, 0, 0)), Vector((-1, 1, 1)))),
}


@dataclass
class Scene:
    """A mesh of loose vertices under an armature of branching bones, with skin weights as an artist leaves them."""

    armature: bpy.types.Object
    mesh: bpy.types.Object
    rest_positions: np.ndarray
    bone_indices: np.ndarray
    bone_weights: np.ndarray

    @property
    def method(self) -> str:
        return "dual-quaternion" if self.mesh.modifiers["Armature"].use_deform_preserve_volume else "linear"

    def bones(self) -> dict[str, np.ndarray]:
        """The pose as our functions take it."""
        bpy.context.view_layer.update()
        armature_matrix = np.linalg.inv(np.array(self.mesh.matrix_world)) @ np.array(self.armature.matrix_world)
        rest = np.array([np.array(bone.matrix_local) for bone in self.armature.data.bones])
        posed = np.array([np.array(self.armature.pose.bones[bone.name].matrix) for bone in self.armature.data.bones])
        return {
            "bone_matrices": armature_matrix @ posed @ np.linalg.inv(rest) @ np.linalg.inv(armature_matrix),
            "bone_rest_matrices": rest,
            "armature_matrix": armature_matrix,
        }

    def evaluated(self) -> np.ndarray:
        bpy.context.view_layer.update()
        mesh = self.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        positions = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
        mesh.vertices.foreach_get("co", positions)
        return positions.reshape(-1, 3).astype(np.float64)

    def pose(self, rng: np.random.Generator, scale: str, bend: float = 1.2) -> None:
        for bone in self.armature.pose.bones:
            bone.rotation_mode = "QUATERNION"
            axis = Vector(rng.normal(size=3)).normalized()
            bone.rotation_quaternion = Quaternion(axis, float(rng.uniform(-bend, bend)))
            bone.location = rng.uniform(-0.3, 0.3, 3)
            bone.scale = SCALES[scale](rng)

    def ours(self) -> np.ndarray:
        return skinning.pose_vertices(
            self.rest_positions, self.bone_indices, self.bone_weights, skinning=self.method, **self.bones()
        )


def make_scene(rng: np.random.Generator, armature_matrix: Matrix, mesh_matrix: Matrix, preserve_volume: bool) -> Scene:
    data = bpy.data.armatures.new("Armature")
    armature = bpy.data.objects.new("Armature", data)
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    joints = np.cumsum(rng.normal(size=(BONES + 1, 3)), axis=0) * 0.5
    bones = []
    for number, (head, tail) in enumerate(pairwise(joints)):
        bone = data.edit_bones.new(f"bone {number}")
        bone.head, bone.tail, bone.roll = head, tail, float(rng.uniform(-3, 3))
        bone.parent = bones[number // 2] if number else None
        bones.append(bone)
    bpy.ops.object.mode_set(mode="OBJECT")

    count = 300
    to_mesh = np.linalg.inv(np.array(mesh_matrix)) @ np.array(armature_matrix)
    points = joints[rng.integers(0, BONES + 1, count)] + rng.normal(size=(count, 3)) * 0.4
    points = points @ to_mesh[:3, :3].T + to_mesh[:3, 3]
    mesh_data = bpy.data.meshes.new("Mesh")
    mesh_data.from_pydata(points.tolist(), [], [])
    mesh = bpy.data.objects.new("Mesh", mesh_data)
    bpy.context.scene.collection.objects.link(mesh)
    mesh.vertex_groups.new(name="no bone of this name")
    for number in rng.permutation(BONES):
        mesh.vertex_groups.new(name=f"bone {number}")
    for vertex in range(count):
        mesh.vertex_groups["no bone of this name"].add([vertex], 0.7, "REPLACE")
        # Some on no bone, some barely, some on a single one; the sums are not one.
        for bone in rng.permutation(BONES)[: vertex % (BONES + 1)]:
            weight = float(rng.uniform(0, 1)) * (1e-5 if vertex % 7 == 0 else 1.0) * float(rng.uniform() > 0.2)
            mesh.vertex_groups[f"bone {bone}"].add([vertex], weight, "REPLACE")
    modifier = mesh.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    modifier.use_deform_preserve_volume = preserve_volume
    armature.matrix_world, mesh.matrix_world = armature_matrix, mesh_matrix
    bpy.context.view_layer.update()

    bone_of_group = {group.index: data.bones.find(group.name) for group in mesh.vertex_groups}
    indices = np.zeros((count, BONES), dtype=np.int32)
    weights = np.zeros((count, BONES))
    for vertex in mesh_data.vertices:
        entries = [(bone_of_group[e.group], e.weight) for e in vertex.groups if bone_of_group[e.group] >= 0]
        for place, (bone, weight) in enumerate(entries):
            indices[vertex.index, place], weights[vertex.index, place] = bone, weight
    rest = np.empty(count * 3, dtype=np.float32)
    mesh_data.vertices.foreach_get("co", rest)
    return Scene(armature, mesh, rest.reshape(-1, 3).astype(np.float64), indices, weights)


def size(positions: np.ndarray) -> float:
    return float(np.ptp(positions, axis=0).max())


@pytest.mark.parametrize("objects", OBJECTS)
@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("preserve_volume", [False, True], ids=["linear", "preserve volume"])
def test_posed_positions_equal_blenders(objects: str, scale: str, preserve_volume: bool) -> None:
    rng = np.random.default_rng(len(objects) * 100 + len(scale))
    scene = make_scene(rng, *OBJECTS[objects], preserve_volume)
    for _ in range(4):
        scene.pose(rng, scale)
        theirs = scene.evaluated()
        assert np.abs(theirs - scene.rest_positions).max() > 0.1 * size(theirs)
        error = np.abs(scene.ours() - theirs).max(axis=1)
        assert error.max() <= 1e-5 * size(theirs), np.argsort(error)[-5:]


@pytest.mark.parametrize("objects", OBJECTS)
@pytest.mark.parametrize("preserve_volume", [False, True], ids=["linear", "preserve volume"])
def test_offsets_in_a_shape_key_show_the_displacement(objects: str, preserve_volume: bool) -> None:
    rng = np.random.default_rng(7)
    scene = make_scene(rng, *OBJECTS[objects], preserve_volume)
    scene.pose(rng, "uneven scale", bend=0.9)
    skinned = scene.evaluated()
    displacements = rng.normal(size=skinned.shape) * 0.05 * size(skinned)
    offsets, residuals = skinning.inverse_skin(
        scene.rest_positions,
        scene.bone_indices,
        scene.bone_weights,
        displacements=displacements,
        skinning=scene.method,
        minimum_stretch=1e-3,
        **scene.bones(),
    )
    assert np.abs(residuals).max() <= 1e-9 * size(skinned)
    scene.mesh.shape_key_add(name="Basis")
    key = scene.mesh.shape_key_add(name="Followthrough")
    key.data.foreach_set("co", (scene.rest_positions + offsets).astype(np.float32).ravel())
    key.value = 1.0
    error = np.abs(scene.evaluated() - (skinned + displacements)).max(axis=1)
    # A shape key is stored in single precision: large offsets, where a bone flattens the skin, are rounded.
    coordinates = np.abs(scene.rest_positions + offsets).max(axis=1)
    assert (error <= 1e-5 * (size(skinned) + coordinates)).all()
    assert np.median(error) <= 1e-6 * size(skinned)


@pytest.mark.parametrize("preserve_volume", [False, True], ids=["linear", "preserve volume"])
def test_jacobians_equal_blenders_slopes(preserve_volume: bool) -> None:
    rng = np.random.default_rng(3)
    scene = make_scene(rng, *OBJECTS["unevenly scaled"], preserve_volume)
    scene.pose(rng, "uneven scale")
    jacobians = skinning.jacobians(
        scene.rest_positions, scene.bone_indices, scene.bone_weights, skinning=scene.method, **scene.bones()
    )
    still = scene.evaluated()
    for axis in range(3):
        moved = scene.rest_positions.copy()
        moved[:, axis] += 1.0
        scene.mesh.data.vertices.foreach_set("co", moved.astype(np.float32).ravel())
        scene.mesh.data.update()
        slope = scene.evaluated() - still
        np.testing.assert_allclose(jacobians[:, :, axis], slope, atol=2e-5 * size(still))
        scene.mesh.data.vertices.foreach_set("co", scene.rest_positions.astype(np.float32).ravel())


def test_the_blend_goes_the_way_round_that_blender_takes() -> None:
    # Bones turned far apart: which of a rotation's two quaternions is taken depends on the order of a vertex's groups.
    rng = np.random.default_rng(11)
    scene = make_scene(rng, *OBJECTS["same place"], preserve_volume=True)
    for _ in range(6):
        scene.pose(rng, "no scale", bend=3.0)
        theirs = scene.evaluated()
        error = np.abs(scene.ours() - theirs).max(axis=1)
        assert error.max() <= 1e-5 * size(theirs)
    reordered = skinning.pose_vertices(
        scene.rest_positions,
        scene.bone_indices[:, ::-1],
        scene.bone_weights[:, ::-1],
        skinning="dual-quaternion",
        **scene.bones(),
    )
    assert np.abs(reordered - theirs).max() > 1e-3 * size(theirs)


def test_animated_objects_move_the_mesh_against_its_armature() -> None:
    rng = np.random.default_rng(5)
    scene = make_scene(rng, *OBJECTS["unevenly scaled"], preserve_volume=True)
    scene.pose(rng, "uneven scale")
    for _ in range(3):
        scene.armature.matrix_world = Matrix.LocRotScale(
            Vector(rng.normal(size=3)), Euler(rng.normal(size=3)), Vector(rng.uniform(0.5, 2, 3))
        )
        theirs = scene.evaluated()
        assert np.abs(scene.ours() - theirs).max() <= 1e-5 * size(theirs)
