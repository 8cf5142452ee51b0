# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that more than one plain Armature modifier moves are sampled, and bake as exactly as others."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import Bake, NotBakeableError, ObjectSettings, clear, skinned_meshes
from followthrough.blender.shape_keys import read_points
from followthrough.settings import Settings, SpringSettings, VolumeSettings

#: Swings by a fifth of the character's size.
SOFT = Settings(
    solver="springs", volume=VolumeSettings(cells=8), springs=SpringSettings(stiffness_range=(600.0, 2400.0))
)


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
    """Which segments a vertex hangs on depends on where it is along the bone."""
    for bone in character.armature.data.bones:
        bone.bbone_segments = 6
    upper = character.armature.pose.bones["Upper"]
    for frame, curve in ((1, 0.0), (4, 0.2), (8, -0.1)):
        upper.bbone_curveinx, upper.bbone_curveoutz = curve, -curve
        upper.keyframe_insert("bbone_curveinx", frame=frame)
        upper.keyframe_insert("bbone_curveoutz", frame=frame)


def bendy_bones_preserving_volume(character):
    bendy_bones(character)
    character.modifier.use_deform_preserve_volume = True


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


def add_lattice(character, interpolation):
    data = bpy.data.lattices.new("Cage")
    cage = bpy.data.objects.new("Cage", data)
    bpy.context.scene.collection.objects.link(cage)
    cage.location.z = 1.0
    cage.scale = (2.0, 2.0, 3.0)
    data.points_u, data.points_v, data.points_w = 3, 3, 4
    data.interpolation_type_u = data.interpolation_type_v = data.interpolation_type_w = interpolation
    for point, shift in zip(data.points, np.random.default_rng(1).normal(0.0, 0.06, (36, 3)), strict=True):
        point.co_deform = np.array(point.co_deform) + shift
    for frame, angle in ((1, 0.0), (4, 0.4), (8, 0.0)):
        cage.rotation_euler.y = angle
        cage.keyframe_insert("rotation_euler", frame=frame)
    character.mesh.modifiers.new("Lattice", "LATTICE").object = cage


def lattice_after(character):
    add_lattice(character, "KEY_BSPLINE")


def lattice_before(character):
    add_lattice(character, "KEY_LINEAR")
    character.mesh.modifiers.move(1, 0)


def mesh_deform(character):
    """A cage that the bones move instead of the mesh."""
    corners = np.array([(x, y, z) for z in np.linspace(-0.3, 2.3, 5) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    sides = [
        (4 * r + s, 4 * r + (s + 1) % 4, 4 * r + 4 + (s + 1) % 4, 4 * r + 4 + s) for r in range(4) for s in range(4)
    ]
    data = bpy.data.meshes.new("Cage")
    data.from_pydata((corners * [0.8, 0.8, 1.0]).tolist(), [], [*sides, (3, 2, 1, 0), (16, 17, 18, 19)])
    cage = bpy.data.objects.new("Cage", data)
    bpy.context.scene.collection.objects.link(cage)
    for bone in ("Lower", "Upper"):
        group = cage.vertex_groups.new(name=bone)
        for index, (_, _, z) in enumerate(corners):
            share = min(1.0, max(0.0, (z - 0.4) / 1.2))
            group.add([index], share if bone == "Upper" else 1.0 - share, "REPLACE")
    character.mesh.modifiers.remove(character.modifier)
    modifier = character.mesh.modifiers.new("Cage", "MESH_DEFORM")
    modifier.object, modifier.precision = cage, 4
    bpy.context.view_layer.update()
    with bpy.context.temp_override(object=character.mesh, active_object=character.mesh):
        bpy.ops.object.meshdeform_bind(modifier="Cage")
    assert modifier.is_bound
    cage.modifiers.new("Armature", "ARMATURE").object = character.armature


def curve_after(character):
    data = bpy.data.curves.new("Path", "CURVE")
    data.dimensions = "3D"
    points = data.splines.new("BEZIER").bezier_points
    points.add(1)
    for point, place, handle in zip(points, ((0, 0, 0), (0, 0.8, 2)), ((0, 0, 0.8), (0, 0.6, 0.6)), strict=True):
        point.co = place
        point.handle_left, point.handle_right = np.subtract(place, handle), np.add(place, handle)
    path = bpy.data.objects.new("Path", data)
    bpy.context.scene.collection.objects.link(path)
    modifier = character.mesh.modifiers.new("Path", "CURVE")
    modifier.object, modifier.deform_axis = path, "POS_Z"


def smooth_after(character):
    """Every vertex is pulled at by its neighbours."""
    modifier = character.mesh.modifiers.new("Smooth", "SMOOTH")
    modifier.factor, modifier.iterations = 0.5, 3


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
    "prepare",
    [
        two_armature_modifiers,
        masked,
        masked_invertedly,
        envelopes,
        bendy_bones,
        bendy_bones_preserving_volume,
        shape_key,
        driven_corrective_key,
        preserve_volume_with_key,
        lattice_before,
        lattice_after,
        mesh_deform,
        curve_after,
        armature_by_parent,
        hook_after,
        smooth_after,
    ],
)
def test_every_frame_is_what_was_there_plus_displacement(character, prepare):
    prepare(character)
    bpy.context.scene.frame_set(1)
    before = traces(character)
    expected = character.displacements(1, 8, SOFT)
    baked = character.bake(ObjectSettings(motion=SOFT)).objects[0]
    assert baked.evaluations_per_frame > 1
    assert max(np.linalg.norm(step, axis=1).max() for step in expected) > 0.05 * character.size
    for frame, displacement in enumerate(expected, start=1):
        error = character.positions(frame) - character.skinned(frame) - displacement
        assert np.linalg.norm(error, axis=1).max() < 2e-5 * character.size
    assert baked.largest_residual < 2e-5 * character.size
    clear(character.mesh)
    assert traces(character) == before


def traces(character):
    """What a search could leave behind."""
    bpy.context.scene.frame_set(1)
    mesh = character.mesh.data
    key = mesh.shape_keys
    points = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", points)
    blocks = (
        [] if key is None else [(block.name, read_points(block).tobytes(), block.value) for block in key.key_blocks]
    )
    return points.tobytes(), blocks, character.mesh.active_shape_key_index, len(bpy.data.shape_keys)


@pytest.mark.parametrize("prepare", [lattice_after, driven_corrective_key])
@pytest.mark.parametrize("steps", [0, 3, 8, 11, 16])
def test_a_cancelled_search_leaves_nothing_behind(character, prepare, steps):
    prepare(character)
    bpy.context.scene.frame_set(1)
    before = traces(character)
    bake = Bake(bpy.context.scene, {character.mesh_name: ObjectSettings(motion=SOFT)})
    assert bake.total == 16
    run = bake.run()
    for _ in range(steps):
        next(run)
    bake.cancel()
    run.close()
    assert bpy.context.scene.frame_current == 1
    assert traces(character) == before


def test_a_search_that_fails_leaves_nothing_behind(character):
    lattice_after(character)
    before = traces(character)
    bake = Bake(bpy.context.scene, {character.mesh_name: ObjectSettings(motion=SOFT)})
    run = bake.run()
    for _ in range(10):
        next(run)
    character.mesh.modifiers.new("Subdivision", "SUBSURF")
    with pytest.raises(ValueError, match=r"frame 3: .*vertices once deformed"):
        list(run)
    assert traces(character) == before


def test_where_it_folds_the_residual_tells(character):
    """Corrective smoothing wipes out detail that then no shape key can show: what is missing is reported."""
    modifier = character.mesh.modifiers.new("Smooth", "CORRECTIVE_SMOOTH")
    modifier.factor, modifier.iterations = 0.5, 5
    expected = character.displacements(1, 8, SOFT)
    baked = character.bake(ObjectSettings(motion=SOFT)).objects[0]
    error = max(
        np.linalg.norm(character.positions(frame) - character.skinned(frame) - displacement, axis=1).max()
        for frame, displacement in enumerate(expected, start=1)
    )
    assert baked.largest_residual == pytest.approx(error, rel=1e-3)
    assert error < 0.02 * baked.largest_displacement


def test_a_mesh_that_keys_cannot_move_is_refused(character):
    mesh = character.mesh.data.copy()
    target = bpy.data.objects.new("Target", mesh)
    bpy.context.scene.collection.objects.link(target)
    character.mesh.modifiers.new("Follow", "SURFACE_DEFORM").target = target
    bpy.context.view_layer.update()
    with bpy.context.temp_override(object=character.mesh, active_object=character.mesh):
        bpy.ops.object.surfacedeform_bind(modifier="Follow")
    before = traces(character)
    with pytest.raises(NotBakeableError, match="whatever its shape keys do"):
        Bake(bpy.context.scene, {character.mesh_name: ObjectSettings(motion=SOFT)})
    assert traces(character) == before


def test_sampling_a_plain_armature_agrees_with_its_formula(make_character):
    plain, sampled = make_character("Plain"), make_character("Sampled")
    sampled.mesh.modifiers.new("Nothing", "SMOOTH").factor = 0.0
    plain.bake()
    assert sampled.bake().objects[0].evaluations_per_frame
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
