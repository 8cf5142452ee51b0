# SPDX-License-Identifier: GPL-3.0-or-later
"""Add makes a character paintable; a click on what to paint is all that it takes from any mode."""

from math import hypot
from types import ModuleType

import bpy
import pytest

from followthrough.blender import MASS_GROUP, PINS_GROUP, STIFFNESS_GROUP

GROUPS = {"STIFFNESS": STIFFNESS_GROUP, "MASS": MASS_GROUP, "PINS": PINS_GROUP}


def weights(obj: bpy.types.Object, name: str) -> list[float]:
    index = obj.vertex_groups[name].index
    return [next((g.weight for g in vertex.groups if g.group == index), 0.0) for vertex in obj.data.vertices]


def test_add_makes_the_groups_and_lists_the_pins(painted: bpy.types.Object) -> None:
    assert set(GROUPS.values()) <= set(painted.vertex_groups.keys())
    assert painted.followthrough.is_added
    assert [pin.name for pin in painted.followthrough.pin_groups] == [PINS_GROUP]


def test_add_pins_and_stiffens_skin_near_the_bones(character: bpy.types.Object) -> None:
    for vertex in character.data.vertices:
        vertex.co.xy *= 0.2 + vertex.co.z
    assert bpy.ops.followthrough.add() == {"FINISHED"}
    radii = [hypot(vertex.co.x, vertex.co.y) for vertex in character.data.vertices]
    near, far = radii.index(min(radii)), radii.index(max(radii))
    for group in (STIFFNESS_GROUP, PINS_GROUP):
        assert weights(character, group)[near] > weights(character, group)[far]


def test_add_keeps_what_was_painted(character: bpy.types.Object) -> None:
    group = character.vertex_groups.new(name=STIFFNESS_GROUP)
    group.add([5], 0.25, "REPLACE")
    assert bpy.ops.followthrough.add() == {"FINISHED"}
    assert weights(character, STIFFNESS_GROUP)[5] == pytest.approx(0.25)
    assert weights(character, STIFFNESS_GROUP)[6] == 0.0


def test_add_says_what_is_wrong_and_changes_nothing(character: bpy.types.Object) -> None:
    character.modifiers.clear()
    character.parent = None
    with pytest.raises(RuntimeError, match="armature"):
        bpy.ops.followthrough.add()
    assert not character.followthrough.is_added
    assert set(character.vertex_groups.keys()) == {"lower", "upper"}


def test_add_refuses_coordinates_that_are_no_numbers(character: bpy.types.Object) -> None:
    character.data.vertices[3].co.x = float("nan")
    with pytest.raises(RuntimeError, match="'Column'"):
        bpy.ops.followthrough.add()
    assert not character.followthrough.is_added
    assert set(character.vertex_groups.keys()) == {"lower", "upper"}


@pytest.mark.parametrize("mode", ["OBJECT", "EDIT", "SCULPT", "VERTEX_PAINT", "WEIGHT_PAINT"])
@pytest.mark.parametrize("target", GROUPS)
def test_painting_starts_from_any_mode(painted: bpy.types.Object, mode: str, target: str) -> None:
    bpy.ops.object.mode_set(mode=mode)
    assert bpy.ops.followthrough.paint(target=target) == {"FINISHED"}
    assert painted.mode == "WEIGHT_PAINT"
    assert painted.vertex_groups.active.name == GROUPS[target]
    assert bpy.ops.followthrough.finish_painting() == {"FINISHED"}
    assert painted.mode == "OBJECT"


def test_painting_starts_beside_a_posed_armature(painted: bpy.types.Object) -> None:
    """Entering weight paint makes the active bone's group active; the click must win."""
    armature = painted.parent
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    armature.data.bones.active = armature.data.bones["upper"]
    armature.select_set(True)
    bpy.context.view_layer.objects.active = painted
    assert bpy.ops.followthrough.paint(target="MASS") == {"FINISHED"}
    assert painted.vertex_groups.active.name == MASS_GROUP


def test_the_painted_target_is_known(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted_target = addon.painting.paint.painted_target
    assert painted_target(painted) is None
    for target in GROUPS:
        bpy.ops.followthrough.paint(target=target)
        assert painted_target(painted) == target
    painted.vertex_groups.active = painted.vertex_groups["upper"]
    assert painted_target(painted) is None


def test_pins_paint_the_chosen_group(painted: bpy.types.Object) -> None:
    assert bpy.ops.followthrough.add_pin_group() == {"FINISHED"}
    bpy.ops.followthrough.paint(target="PINS")
    assert painted.vertex_groups.active.name == "Followthrough Pins.001"
    painted.followthrough.active_pin_group = 0
    bpy.ops.followthrough.paint(target="PINS")
    assert painted.vertex_groups.active.name == PINS_GROUP


def test_a_group_that_is_gone_is_made_again_where_it_is_painted(painted: bpy.types.Object) -> None:
    suggested = weights(painted, MASS_GROUP)
    painted.vertex_groups.remove(painted.vertex_groups[MASS_GROUP])
    painted.vertex_groups.remove(painted.vertex_groups[PINS_GROUP])
    assert bpy.ops.followthrough.paint(target="MASS") == {"FINISHED"}
    assert painted.vertex_groups.active.name == MASS_GROUP
    assert weights(painted, MASS_GROUP) == suggested
    assert PINS_GROUP not in painted.vertex_groups, "pins may have been taken out on purpose"
    with pytest.raises(RuntimeError, match=f"{PINS_GROUP}.*choose another one"):
        bpy.ops.followthrough.paint(target="PINS")


def test_removing_a_pin_group_keeps_its_weights(painted: bpy.types.Object) -> None:
    before = weights(painted, PINS_GROUP)
    assert bpy.ops.followthrough.remove_pin_group() == {"FINISHED"}
    assert not len(painted.followthrough.pin_groups)
    assert weights(painted, PINS_GROUP) == before
    assert not bpy.ops.followthrough.remove_pin_group.poll()
    with pytest.raises(RuntimeError, match="pin group"):
        bpy.ops.followthrough.paint(target="PINS")
    # Adding takes up the group that is there already.
    assert bpy.ops.followthrough.add_pin_group() == {"FINISHED"}
    assert painted.followthrough.pin_groups[0].name == PINS_GROUP


def test_a_mesh_is_chosen_from_its_armature(painted: bpy.types.Object) -> None:
    armature = painted.parent
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="POSE")
    assert not bpy.ops.followthrough.paint.poll()
    assert bpy.ops.followthrough.select_character(name=painted.name) == {"FINISHED"}
    assert bpy.context.object == painted
    assert bpy.context.selected_objects == [painted]


def test_painting_goes_on_with_the_group_chosen_in_the_list(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.add_pin_group()
    bpy.ops.followthrough.paint(target="PINS")
    painted.followthrough.active_pin_group = 0
    assert painted.vertex_groups.active.name == PINS_GROUP
    # Looking through the list while something else is painted changes nothing.
    bpy.ops.followthrough.paint(target="MASS")
    painted.followthrough.active_pin_group = 1
    assert painted.vertex_groups.active.name == MASS_GROUP


def test_the_weight_to_paint_is_within_reach(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.paint(target="PINS")
    owner = addon.painting.paint.brush_weight_owner(bpy.context)
    if owner is not None:  # without a window Blender may not have chosen a brush
        owner.weight = 0.3
        assert owner.weight == pytest.approx(0.3)
