# SPDX-License-Identifier: GPL-3.0-or-later
"""Registering leaves nothing behind, and every operator keeps Blender's conventions."""

from types import ModuleType

import bpy
import pytest


def registered_names() -> set[str]:
    types = {name for name in dir(bpy.types) if name.lower().startswith("followthrough")}
    return types | {f"ops.{name}" for name in dir(bpy.ops.followthrough)}


def test_round_trip_leaves_nothing(addon: ModuleType) -> None:
    before = registered_names()
    assert any(name.startswith("ops.") for name in before)
    addon.unregister()
    assert registered_names() == set()
    assert not hasattr(bpy.types.Object, "followthrough")
    addon.register()
    assert registered_names() == before


def test_a_class_that_is_refused_takes_the_others_with_it(addon: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    class Refused(bpy.types.Operator):
        bl_idname = "followthrough_without_a_dot"
        bl_label = "Refused"

    addon.unregister()
    registration = addon.registration
    with monkeypatch.context() as patch:
        patch.setattr(registration, "_classes", (*registration._classes, Refused))
        with pytest.raises((RuntimeError, ValueError)):
            addon.register()
    assert registered_names() == set()
    addon.register()


def test_every_action_can_be_undone_under_its_name(addon: ModuleType) -> None:
    """All but those that leave the file alone: one deletes a cache, one shows a preview that leaves no trace."""
    untouching = {
        addon.bake.discard.FOLLOWTHROUGH_OT_discard_stopped_bake,
        addon.preview.operator.FOLLOWTHROUGH_OT_preview,
    }
    for cls in addon.registration._classes:
        if issubclass(cls, bpy.types.Operator) and cls not in untouching:
            assert {"REGISTER", "UNDO"} <= cls.bl_options, cls
            assert cls.bl_label.replace(" from ", " From ").istitle(), cls  # prepositions stay small


def test_tooltips_have_no_full_stop(addon: ModuleType) -> None:
    for cls in addon.registration._classes:
        texts = [getattr(cls, "bl_description", "")]
        texts += [prop.description for prop in cls.bl_rna.properties if prop.identifier in cls.__annotations__]
        assert not [text for text in texts if text.endswith(".")], cls


def test_settings_stay_with_the_object_while_the_add_on_is_off(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.followthrough.frequency_stiff = 11.0
    addon.unregister()
    addon.register()
    assert painted.followthrough.is_added
    assert abs(painted.followthrough.frequency_stiff - 11.0) < 1e-6
