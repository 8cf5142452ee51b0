# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that more than one plain Armature modifier moves are sampled, and bake as exactly as their kind allows."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import skinned_meshes


def two_armature_modifiers(character):
    modifier = character.mesh.modifiers.new("Again", "ARMATURE")
    modifier.object = character.armature


def masked(character):
    group = character.mesh.vertex_groups.new(name="Mask")
    group.add(range(40, 72), 0.7, "REPLACE")
    character.modifier.vertex_group = "Mask"


def masked_invertedly(character):
    masked(character)
    character.modifier.invert_vertex_group = True


def envelopes(character):
    character.modifier.use_bone_envelopes = True


def bendy_bones(character):
    character.armature.data.bones["Upper"].bbone_segments = 5


def shape_key(character):
    character.mesh.shape_key_add(name="Basis")
    fat = character.mesh.shape_key_add(name="Fat")
    for point in fat.data:
        point.co.x *= 1.4
    for frame, value in ((1, 0.0), (8, 1.0)):
        fat.value = value
        fat.keyframe_insert("value", frame=frame)


def driven_corrective_key(character):
    character.mesh.shape_key_add(name="Basis")
    fat = character.mesh.shape_key_add(name="Corrective")
    for point in fat.data:
        point.co.y *= 1.3
    driver = fat.driver_add("value").driver
    variable = driver.variables.new()
    variable.name, variable.type = "angle", "TRANSFORMS"
    variable.targets[0].id = character.armature
    variable.targets[0].bone_target = "Upper"
    variable.targets[0].transform_type = "ROT_X"
    variable.targets[0].transform_space = "LOCAL_SPACE"
    driver.expression = "angle"


def preserve_volume_with_key(character):
    character.modifier.use_deform_preserve_volume = True
    shape_key(character)


def lattice_before(character):
    data = bpy.data.lattices.new("Cage")
    cage = bpy.data.objects.new("Cage", data)
    bpy.context.scene.collection.objects.link(cage)
    cage.location.z = 1.0
    cage.scale = (2.0, 2.0, 4.0)
    data.interpolation_type_u = data.interpolation_type_v = data.interpolation_type_w = "KEY_LINEAR"
    data.points[7].co_deform.x += 0.3
    modifier = character.mesh.modifiers.new("Lattice", "LATTICE")
    modifier.object = cage
    character.mesh.modifiers.move(1, 0)


def armature_by_parent(character):
    character.mesh.modifiers.remove(character.modifier)
    character.mesh.parent_type = "ARMATURE"


def hook_after(character):
    hook = bpy.data.objects.new("Hook", None)
    bpy.context.scene.collection.objects.link(hook)
    modifier = character.mesh.modifiers.new("Hook", "HOOK")
    modifier.object = hook
    modifier.vertex_indices_set(range(64, 72))
    for frame, x in ((1, 0.0), (8, 0.5)):
        hook.location.x = x
        hook.keyframe_insert("location", frame=frame)


@pytest.mark.parametrize(
    ("prepare", "tolerance"),
    [
        (two_armature_modifiers, 1e-4),
        (masked, 1e-4),
        (masked_invertedly, 1e-4),
        (envelopes, 1e-4),
        (bendy_bones, 3e-3),  # which segments a vertex hangs on depends on where it is: no derivative tells all
        (shape_key, 1e-4),
        (driven_corrective_key, 1e-4),
        (preserve_volume_with_key, 1e-4),
        (lattice_before, 1e-2),  # it bends space, and a derivative is straight
        (armature_by_parent, 1e-4),
        (hook_after, 1e-4),
    ],
)
def test_every_frame_is_what_was_there_plus_displacement(character, prepare, tolerance):
    prepare(character)
    bpy.context.scene.frame_set(1)
    rest = np.array([vertex.co for vertex in character.mesh.data.vertices])
    expected = character.displacements(1, 8)
    assert np.array_equal(rest, np.array([vertex.co for vertex in character.mesh.data.vertices]))
    report = character.bake()
    assert report.objects[0].sampled
    assert max(np.abs(step).max() for step in expected) > 0.005 * character.size
    for frame, displacement in enumerate(expected, start=1):
        error = character.positions(frame) - character.skinned(frame) - displacement
        assert np.abs(error).max() < tolerance * character.size + report.objects[0].largest_residual


def test_sampling_a_plain_armature_agrees_with_its_formula(make_character):
    plain, sampled = make_character("Plain"), make_character("Sampled")
    sampled.mesh.modifiers.new("Nothing", "SMOOTH").factor = 0.0
    plain.bake()
    assert sampled.bake().objects[0].sampled
    largest = np.abs(plain.offsets()).max()
    # The volume follows the surface in one case and the bones in the other, so only about the same motion comes out.
    assert np.abs(plain.offsets() - sampled.offsets()).max() < 0.5 * largest


def test_modifiers_behind_the_deformation_are_passed_over(character):
    character.mesh.modifiers.new("Smooth", "SMOOTH").factor = 0.2
    character.bake()
    without = character.offsets()
    character.mesh.modifiers.new("Subdivision", "SUBSURF").levels = 2
    character.bake()
    assert np.array_equal(character.offsets(), without)
    assert character.mesh.modifiers["Subdivision"].show_viewport


def test_skinned_meshes_are_found(character):
    data = bpy.data.meshes.new("Prop")
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Prop", data))
    assert [obj.name for obj in skinned_meshes(bpy.context.scene)] == [character.mesh_name]
