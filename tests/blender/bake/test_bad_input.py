# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever cannot be baked is refused with a reason, before anything has changed."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    Bake,
    FrameRange,
    NotBakeableError,
    ObjectSettings,
    PaintGroups,
    PinGroup,
    why_not_bakeable,
)


def no_armature(character):
    character.mesh.modifiers.remove(character.modifier)
    return "moved by no armature"


def armature_modifier_without_object(character):
    character.modifier.object = None
    return "moved by no armature"


def armature_modifier_switched_off(character):
    character.modifier.show_viewport = False
    return "'Armature' switched off in the viewport"


def empty_mesh(character):
    character.mesh.data.clear_geometry()
    return "empty mesh"


def mesh_without_faces(character):
    points = [tuple(vertex.co) for vertex in character.mesh.data.vertices]
    character.mesh.data.clear_geometry()
    character.mesh.data.from_pydata(points, [], [])
    return "no faces"


def shared_mesh(character):
    twin = bpy.data.objects.new("Twin", character.mesh.data)
    bpy.context.scene.collection.objects.link(twin)
    return "shares its mesh with 'Twin'"


def absolute_keys(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.data.shape_keys.use_relative = False
    return "absolute shape keys"


def solo_key(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.show_only_shape_key = True
    return "only its active shape key"


def generative_modifier_before(character):
    character.mesh.modifiers.new("Mirror", "MIRROR")
    character.mesh.modifiers.move(1, 0)
    return "deformed by 'Armature' after 'Mirror'"


def cached_positions(character):
    character.mesh.modifiers.new("Cache", "MESH_CACHE")
    return "'Cache', which replaces"


PANEL_REASONS = [
    no_armature,
    armature_modifier_without_object,
    armature_modifier_switched_off,
    empty_mesh,
    mesh_without_faces,
    shared_mesh,
    absolute_keys,
    solo_key,
    generative_modifier_before,
    cached_positions,
]


@pytest.mark.parametrize("spoil", PANEL_REASONS)
def test_the_panel_and_the_bake_tell_why(character, spoil):
    assert why_not_bakeable(character.mesh) is None
    reason = spoil(character)
    assert reason in why_not_bakeable(character.mesh)
    refused(character, reason)


def refused(character, reason, settings=None, frames=None):
    scene = bpy.context.scene
    scene.frame_set(3, subframe=0.5)
    with pytest.raises(ValueError) as problem:
        Bake(scene, {character.mesh_name: settings or ObjectSettings()}, frames)
    assert reason in str(problem.value)
    assert (scene.frame_current, scene.frame_subframe) == (3, 0.5)
    key = character.mesh.data.shape_keys
    assert key is None or key.key_blocks.keys() == ["Basis"]
    assert not any(action.name.startswith("Followthrough") for action in bpy.data.actions)


def no_weights(character):
    character.mesh.vertex_groups.clear()
    return "no weights for the deforming bones of 'Creature rig'"


def bones_that_do_not_deform(character):
    for bone in character.armature.data.bones:
        bone.use_deform = False
    return "no weights for the deforming bones"


def not_a_number(character):
    character.mesh.data.vertices[7].co.y = float("nan")
    return "NaN or infinity), first at vertex 7"


def not_a_number_in_the_basis(character):
    character.mesh.shape_key_add(name="Basis").data[5].co.z = float("nan")
    return "NaN or infinity), first at vertex 5"


def flat_scale(character):
    character.armature.scale.z = 0.0
    return "scale is 0"


def hidden(character):
    character.mesh.hide_viewport = True
    return "is hidden"


def in_a_hidden_collection(character):
    collection = bpy.data.collections.new("Hidden")
    bpy.context.scene.collection.children.link(collection)
    bpy.context.scene.collection.objects.unlink(character.mesh)
    collection.objects.link(character.mesh)
    collection.hide_viewport = True
    bpy.context.view_layer.update()
    return "is hidden"


def rest_position(character):
    character.armature.data.pose_position = "REST"
    return "'Creature rig' in Rest Position"


@pytest.mark.parametrize(
    "spoil",
    [
        rest_position,
        no_weights,
        bones_that_do_not_deform,
        not_a_number,
        not_a_number_in_the_basis,
        flat_scale,
        hidden,
        in_a_hidden_collection,
    ],
)
def test_the_bake_tells_what_a_panel_cannot_see(character, spoil):
    refused(character, spoil(character))


@pytest.mark.parametrize(
    "groups", [PaintGroups(stiffness="No"), PaintGroups(mass="No"), PaintGroups(pins=(PinGroup("No"),))]
)
def test_a_missing_group_is_named(character, groups):
    refused(character, "no vertex group 'No'", ObjectSettings(groups=groups))


def test_zero_frames_are_refused(character):
    refused(character, "at least one frame", frames=FrameRange(start=5, end=4))
    with pytest.raises(ValueError, match="preroll"):
        FrameRange(preroll=-1)
    with pytest.raises(ValueError, match="strength"):
        PinGroup("A", 1.5)


def test_other_objects_are_refused(character):
    assert "is no mesh" in why_not_bakeable(character.armature)
    with pytest.raises(NotBakeableError, match="is no mesh"):
        Bake(bpy.context.scene, {character.armature_name: ObjectSettings()})
    with pytest.raises(NotBakeableError, match="'Nobody' is not in scene"):
        Bake(bpy.context.scene, {"Nobody": ObjectSettings()})
    with pytest.raises(NotBakeableError, match="no object to bake"):
        Bake(bpy.context.scene, {})


@pytest.mark.parametrize("override", [False, True])
def test_a_linked_mesh_is_refused(character, tmp_path, override):
    path = tmp_path / "library.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.objects = [character.mesh_name, character.armature_name]
    for obj in wanted.objects:
        bpy.context.scene.collection.objects.link(obj)
    mesh = wanted.objects[0]
    if override:
        mesh = mesh.override_create(remap_local_usages=True)
    assert "lost when the file is opened again" in why_not_bakeable(mesh)
    with pytest.raises(NotBakeableError, match="linked"):
        Bake(bpy.context.scene, {mesh.name: ObjectSettings()})
    assert mesh.data.shape_keys is None


@pytest.mark.parametrize("sampled", [False, True])
def test_a_scale_that_passes_through_zero_is_refused(character, sampled):
    if sampled:
        character.mesh.modifiers.new("Nothing", "SMOOTH").factor = 0.0
    for frame, scale in ((1, 1.0), (4, 0.0), (8, 1.0)):
        character.armature.scale.x = scale
        character.armature.keyframe_insert("scale", frame=frame)
    bpy.context.scene.frame_set(2)
    bake = Bake(bpy.context.scene, {character.mesh_name: ObjectSettings()})
    with pytest.raises(ValueError, match=r"frame 4: Object 'Creature.*' is flat"):
        list(bake.run())
    assert character.mesh.data.shape_keys is None
    assert bpy.context.scene.frame_current == 2


def test_one_bad_object_stops_all(make_character):
    good, bad = make_character("Good"), make_character("Bad")
    bad.mesh.modifiers.remove(bad.modifier)
    with pytest.raises(NotBakeableError, match="'Bad'"):
        Bake(bpy.context.scene, {"Good": ObjectSettings(), "Bad": ObjectSettings()})
    assert good.mesh.data.shape_keys is None


def test_a_mesh_that_changes_while_it_is_baked_is_not_written(make_character):
    first, second = make_character("First"), make_character("Second")
    bake = Bake(bpy.context.scene, {"First": ObjectSettings(), "Second": ObjectSettings()})
    list(bake.run())
    second.mesh.data.vertices.add(1)
    with pytest.raises(NotBakeableError, match="'Second' has been removed or changed"):
        bake.finish()
    assert first.mesh.data.shape_keys is None
    assert np.isfinite(first.positions(1)).all()
