# SPDX-License-Identifier: GPL-3.0-or-later
"""After Add, painting, Bake and Remove a file holds what it held before."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

import bpy
import numpy as np
import pytest

from followthrough.blender import MASS_GROUP, PINS_GROUP, has_learned
from followthrough.blender.actions import _curves

from .conftest import make_character, select
from .file_contents import keys


def described(animation: Any) -> Any:
    """What is animated, by what."""
    if animation is None:
        return None
    actions = [animation.action, *(strip.action for track in animation.nla_tracks for strip in track.strips)]
    curves = [
        (action.name, curve.data_path, [tuple(point.co) for point in curve.keyframe_points])
        for action in actions
        if action is not None
        for curve in _curves(action)
    ]
    slot = getattr(animation, "action_slot", None)
    tracks = [(track.name, track.mute, [strip.name for strip in track.strips]) for track in animation.nla_tracks]
    return curves, slot and slot.identifier, tracks, [driver.data_path for driver in animation.drivers]


def contents() -> dict[str, Any]:
    """All of the file that Followthrough could touch."""
    state: dict[str, Any] = {
        prop.identifier: sorted(getattr(bpy.data, prop.identifier).keys())
        for prop in bpy.data.bl_rna.properties
        if prop.type == "COLLECTION"
        and prop.identifier not in {"all_ids", "brushes", "libraries"}  # painting brings these
    }
    scene = bpy.context.scene
    state["scene"] = (scene.frame_current, scene.frame_subframe, sorted(scene.keys()), bpy.context.object.name)
    for obj in bpy.data.objects:
        state[f"object {obj.name}"] = (
            obj.mode,
            sorted(obj.keys()),
            [(group.name, group.lock_weight) for group in obj.vertex_groups],
            obj.vertex_groups.active_index,
            obj.active_shape_key_index,
            [(modifier.name, modifier.show_viewport, modifier.show_render) for modifier in obj.modifiers],
            described(obj.animation_data),
        )
    for mesh in bpy.data.meshes:
        state[f"mesh {mesh.name}"] = (
            sorted(mesh.keys()),
            np.array([vertex.co for vertex in mesh.vertices]).tolist(),
            [sorted((entry.group, entry.weight) for entry in vertex.groups) for vertex in mesh.vertices],
            sorted(mesh.attributes.keys()),
        )
    for key in bpy.data.shape_keys:
        blocks = [
            (block.name, block.value, block.mute, np.array([point.co for point in block.data]).tolist())
            for block in key.key_blocks
        ]
        state[f"key {key.name}"] = (sorted(key.keys()), blocks, described(key.animation_data))
    return state


def plain(_obj: bpy.types.Object) -> None:
    """Nothing but a skinned mesh."""


def own_groups(obj: bpy.types.Object) -> None:
    """Groups that happen to have our names, one of them the active one."""
    for name in (MASS_GROUP, PINS_GROUP):
        obj.vertex_groups.new(name=name).add([3, 5], 0.25, "REPLACE")
    obj.vertex_groups.active = obj.vertex_groups[MASS_GROUP]


def own_keys(obj: bpy.types.Object) -> None:
    """Shape keys with an action."""
    obj.shape_key_add(name="Basis")
    smile = obj.shape_key_add(name="Smile")
    smile.data[7].co.x += 0.3
    for frame, value in ((1, 0.0), (9, 1.0)):
        smile.value = value
        smile.keyframe_insert("value", frame=frame)
    obj.active_shape_key_index = 1
    bpy.context.scene.frame_set(3)


def own_driver_and_track(obj: bpy.types.Object) -> None:
    """Shape keys with a driver and an NLA track."""
    own_keys(obj)
    key = obj.data.shape_keys
    track = key.animation_data.nla_tracks.new()
    track.strips.new("Talk", 1, key.animation_data.action)
    key.animation_data.action = None
    obj.shape_key_add(name="Driven").driver_add("value").driver.expression = "frame / 100"
    bpy.context.scene.frame_set(3)


@pytest.mark.parametrize("foreign", [plain, own_groups, own_keys, own_driver_and_track])
def test_remove_leaves_the_file_as_it_was(
    character: bpy.types.Object, foreign: Callable[[bpy.types.Object], None]
) -> None:
    foreign(character)
    before = contents()
    bpy.ops.followthrough.add()
    settings = character.followthrough
    settings.cells, settings.use_loop, settings.frame_end = 8, True, 20
    bpy.ops.followthrough.add_pin_group()
    bpy.ops.followthrough.paint(target="PINS")
    assert character.mode == "WEIGHT_PAINT"
    bpy.ops.followthrough.bake()
    bpy.ops.followthrough.bake()
    assert contents() != before
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert contents() == before
    assert not character.followthrough.is_added
    assert not character.followthrough.is_property_set("cells")
    bpy.ops.followthrough.add()
    assert character.followthrough.cells != 8


def test_remove_acts_on_the_selected_characters_alone(painted: bpy.types.Object) -> None:
    second, third = make_character("Second"), make_character("Third")
    for obj in (second, third):
        select(obj)
        bpy.ops.followthrough.add()
    select(painted, second)
    bpy.ops.followthrough.remove()
    assert [obj.followthrough.is_added for obj in (painted, second, third)] == [False, False, True]
    assert PINS_GROUP in third.vertex_groups


def test_remove_works_where_nothing_can_be_baked_any_more(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    painted.modifiers.clear()
    painted.parent = None
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert painted.data.shape_keys is None
    assert list(painted.vertex_groups.keys()) == ["lower", "upper"]


def test_remove_keeps_edit_mode_and_groups_of_new_names(painted: bpy.types.Object) -> None:
    painted.vertex_groups[PINS_GROUP].name = "Belt"
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.followthrough.remove()
    assert painted.mode == "EDIT"
    assert list(painted.vertex_groups.keys()) == ["lower", "upper", "Belt"]


def test_remove_waits_for_the_bake(addon: ModuleType, painted: bpy.types.Object) -> None:
    settings = addon.properties.bake_settings
    objects = {painted.name: settings.object_settings(painted)}
    addon.bake.session.BakeSession(bpy.context.scene, objects, settings.frame_range(painted))
    assert not bpy.ops.followthrough.remove.poll()
    addon.bake.stop()
    assert bpy.ops.followthrough.remove.poll()


def test_undo_takes_the_whole_removal_back(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    name = painted.name
    bpy.ops.ed.undo_push(message="Before")
    bpy.ops.followthrough.remove()
    bpy.ops.ed.undo_push(message="Remove Followthrough")
    bpy.ops.ed.undo()
    back = bpy.data.objects[name]
    assert back.followthrough.is_added
    assert back.followthrough.cells == 8
    assert len(back.data.shape_keys.key_blocks) == 13
    assert PINS_GROUP in back.vertex_groups


def test_what_another_character_shares_stays(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    bpy.ops.followthrough.learn()
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.object
    assert twin != painted
    assert twin.data == painted.data
    groups, baked = painted.vertex_groups.keys(), keys(painted)
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert not twin.followthrough.is_added
    assert painted.vertex_groups.keys() == groups
    assert keys(painted) == baked
    assert has_learned(painted)
    select(painted)
    bpy.ops.followthrough.remove()
    assert PINS_GROUP not in painted.vertex_groups
    assert keys(painted) == []
