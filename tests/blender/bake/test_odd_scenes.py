# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that are set up unlike most still bake to what was there plus the displacement."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import FrameRange, clear


def time_stretched(character):
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 100, 150


def time_compressed(character):
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 300, 200


def time_compressed_with_keys(character):
    """Our curves then play from a track beside the others."""
    character.mesh.shape_key_add(name="Basis")
    character.mesh.shape_key_add(name="Smile").keyframe_insert("value", frame=1)
    time_compressed(character)


def sheared(character):
    parent = bpy.data.objects.new("Parent", None)
    bpy.context.scene.collection.objects.link(parent)
    parent.scale = (1.0, 2.0, 0.5)
    character.armature.parent = parent
    character.armature.rotation_euler = (0.5, 0.3, 0.2)
    character.mesh.rotation_euler = (0.1, 0.4, 0.3)


def mirrored(character):
    character.armature.scale = (-1.0, -1.0, -1.0)
    character.mesh.scale = (1.0, -0.7, 1.0)


def moving_object(character):
    for frame, x in ((1, 0.0), (4, 1.0), (8, 0.0)):
        character.armature.location.x = character.armature.rotation_euler.z = x
        character.armature.scale = np.full(3, 1.0 + x)
        for channel in ("location", "rotation_euler", "scale"):
            character.armature.keyframe_insert(channel, frame=frame)


def far_away(character):
    character.armature.location.x = 1e6


def nla_alone(character):
    animation = character.armature.animation_data
    action, slot = animation.action, getattr(animation, "action_slot", None)
    animation.action = None
    strip = animation.nla_tracks.new().strips.new("Swing", 1, action)
    if slot is not None:
        strip.action_slot = slot


def driven(character):
    character.armature.animation_data_clear()
    character.armature.pose.bones["Upper"].driver_add("rotation_euler", 0).driver.expression = "sin(frame)"


def constrained(character):
    target = bpy.data.objects.new("Target", None)
    bpy.context.scene.collection.objects.link(target)
    for frame, x in ((1, 0.5), (5, -0.5)):
        target.location = (x, 1.0, 1.6)
        target.keyframe_insert("location", frame=frame)
    character.armature.pose.bones["Upper"].constraints.new("DAMPED_TRACK").target = target


def hidden_armature(character):
    character.armature.hide_viewport = True


def excluded_armature(character):
    collection = bpy.data.collections.new("Rig")
    bpy.context.scene.collection.children.link(collection)
    bpy.context.scene.collection.objects.unlink(character.armature)
    collection.objects.link(character.armature)
    bpy.context.view_layer.layer_collection.children["Rig"].exclude = True


def armature_in_edit_mode(character):
    bpy.context.view_layer.objects.active = character.armature
    bpy.ops.object.mode_set(mode="EDIT")


def armature_in_pose_mode(character):
    bpy.context.view_layer.objects.active = character.armature
    bpy.ops.object.mode_set(mode="POSE")


@pytest.mark.parametrize(
    "prepare",
    [
        time_stretched,
        time_compressed,
        time_compressed_with_keys,
        sheared,
        mirrored,
        moving_object,
        far_away,
        nla_alone,
        driven,
        constrained,
        hidden_armature,
        excluded_armature,
        armature_in_edit_mode,
        armature_in_pose_mode,
    ],
)
def test_every_frame_is_skinning_plus_displacement(character, prepare):
    prepare(character)
    mode, scene = character.armature.mode, bpy.context.scene
    scene.frame_set(3, subframe=0.25)
    character.bake()
    assert character.armature.mode == mode
    assert (scene.frame_current, scene.frame_subframe) == (3, 0.25)
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    played = [character.positions(frame) for frame in range(1, 9)]
    between = character.positions(4.5, world=False) - character.skinned(4.5)
    skinned = [character.skinned(frame) for frame in range(1, 9)]
    assert np.isfinite(between).all()
    clear(character.mesh)
    displacements = character.displacements(1, 8)
    assert max(np.abs(step).max() for step in displacements) > 0.01 * character.size
    tolerance = 1e-5 * character.size + 1e-7 * np.abs(skinned[0]).max()
    for after, before, displacement in zip(played, skinned, displacements, strict=True):
        assert np.abs(after - before - displacement).max() < tolerance


@pytest.mark.parametrize("frame_map", [(100, 150), (300, 200)])
def test_between_frames_of_remapped_time_it_is_linear(character, frame_map):
    scene = bpy.context.scene
    scene.render.frame_map_old, scene.render.frame_map_new = frame_map
    character.bake()
    character.armature.animation_data_clear()
    character.armature.pose.bones["Upper"].rotation_euler.x = 0.0
    third, half, fourth = (character.positions(frame) for frame in (3, 3.5, 4))
    assert np.abs(third - fourth).max() > 1e-3 * character.size
    assert np.abs(half - (third + fourth) / 2).max() < 1e-5 * character.size


@pytest.mark.parametrize("with_keys", [False, True])
@pytest.mark.parametrize("frame_map", [(100, 150), (300, 200), (100, 100)])
def test_every_key_is_full_at_its_frame(character, frame_map, with_keys):
    scene = bpy.context.scene
    if with_keys:
        character.mesh.shape_key_add(name="Basis")
        character.mesh.shape_key_add(name="Smile").keyframe_insert("value", frame=1)
    scene.render.frame_map_old, scene.render.frame_map_new = frame_map
    character.bake(frames=FrameRange(start=2, end=6))
    blocks = character.mesh.data.shape_keys.key_blocks
    ours = [block for block in blocks if block.name.startswith("Followthrough")]
    for frame in range(1, 8):
        scene.frame_set(frame)
        wanted = [float(frame == keyed) for keyed in range(2, 7)]
        assert [block.value for block in ours] == pytest.approx(wanted, abs=1e-5)


def test_a_character_that_does_not_move_is_told(make_character):
    baked = make_character("Still", animate=False).bake().objects[0]
    assert baked.largest_displacement == 0.0
    assert any("nothing moves" in warning for warning in baked.warnings)
    assert make_character("Moving").bake().objects[0].warnings == ()
