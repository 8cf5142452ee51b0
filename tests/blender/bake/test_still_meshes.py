# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes are not deformed while only bones are read, unless that could change what is baked; afterwards all is as it was."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import Bake, ObjectSettings
from followthrough.settings import Settings, VolumeSettings

COARSE = ObjectSettings(motion=Settings(solver="springs", volume=VolumeSettings(cells=8)))


def started(*characters):
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE for character in characters})
    run = bake.run()
    next(run)
    return bake, run


def pinned_to(follower, leader):
    """The follower's rig hangs on a vertex of the leader's deformed mesh."""
    group = leader.mesh.vertex_groups.new(name="Tip")
    group.add([len(leader.mesh.data.vertices) - 1], 1.0, "REPLACE")
    pin = follower.armature.constraints.new("COPY_LOCATION")
    pin.target, pin.subtarget = leader.mesh, "Tip"
    bpy.context.view_layer.update()


def test_the_modifier_is_off_while_bones_are_read_and_on_between_and_afterwards(character):
    bake, run = started(character)
    assert not character.modifier.show_viewport
    bake.show()
    assert character.modifier.show_viewport
    assert np.abs(character.positions(4) - character.positions(1)).max() > 0.01
    list(run)
    bake.finish()
    assert character.modifier.show_viewport


@pytest.mark.parametrize("end", ["cancel", "close", "error"])
def test_however_a_bake_ends_the_modifier_is_on(character, end):
    if end == "error":
        for bone in character.armature.pose.bones:
            bone.driver_add("location", 1).driver.expression = "3e38 if frame > 4 else 0"
    bake, run = started(character)
    if end == "cancel":
        bake.cancel()
    elif end == "close":
        run.close()
    else:
        with pytest.raises(ValueError, match="finite"):
            list(run)
    assert character.modifier.show_viewport


def test_a_rig_that_hangs_on_a_baked_mesh_follows_its_deformation(make_character):
    leader, follower = make_character("Leader"), make_character("Follower")
    pinned_to(follower, leader)
    expected = follower.displacements(1, 8)
    assert max(np.abs(step).max() for step in expected) > 0.01
    bake, run = started(leader, follower)
    assert leader.modifier.show_viewport
    assert not follower.modifier.show_viewport
    list(run)
    bake.finish()
    leader_keys = leader.mesh.data.shape_keys
    for block in leader_keys.key_blocks:  # on its baked surface the follower would hang elsewhere
        block.mute = True
    for frame, displacement in enumerate(expected, start=1):
        error = follower.positions(frame) - follower.skinned(frame) - displacement
        assert np.abs(error).max() < 1e-5 * follower.size


def test_what_a_mesh_reaches_through_others_counts(make_character):
    leader, follower = make_character("Leader"), make_character("Follower")
    between = bpy.data.objects.new("Between", None)
    bpy.context.scene.collection.objects.link(between)
    pinned_to(follower, leader)
    between.constraints.new("COPY_LOCATION").target = leader.mesh
    between.constraints[0].subtarget = "Tip"
    follower.armature.constraints[0].target = between
    bake, _ = started(leader, follower)
    assert leader.modifier.show_viewport
    bake.cancel()


def hidden(character):
    character.armature.hide_viewport = True


def animated_modifier(character):
    character.modifier.keyframe_insert("show_viewport", frame=1)


def driven_scene(character):
    """A scene's property could pass on where a vertex of the mesh is."""
    bpy.context.scene.driver_add("gravity", 0).driver.expression = "frame"


@pytest.mark.parametrize("prepare", [hidden, animated_modifier, driven_scene])
def test_where_it_could_matter_the_mesh_is_deformed(character, prepare):
    prepare(character)
    bake, _ = started(character)
    assert character.modifier.show_viewport
    bake.cancel()


def test_frame_handlers_see_the_deformed_mesh(character):
    seen = []

    def look(_scene, _depsgraph):
        seen.append(character.modifier.show_viewport)

    bpy.app.handlers.frame_change_post.append(look)
    try:
        character.bake()
    finally:
        bpy.app.handlers.frame_change_post.remove(look)
    assert len(seen) >= 8
    assert all(seen)
