# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels say what is missing, and draw in every state that an artist can bring them into.

A window's layout cannot be had in the background, so the panels draw into one that writes down what it is told.
"""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import bpy
import pytest

from followthrough.blender import bake_recovery

from .conftest import link_into_new_file, make_local


class RecordingLayout:
    """Takes the place of a layout: remembers texts, and checks properties, operators and arguments with Blender."""

    def __init__(self, texts: list[str] | None = None, icons: list[str] | None = None) -> None:
        object.__setattr__(self, "texts", [] if texts is None else texts)
        object.__setattr__(self, "icons", [] if icons is None else icons)

    def __setattr__(self, name: str, value: Any) -> None:
        assert name in bpy.types.UILayout.bl_rna.properties, name

    def __getattr__(self, name: str) -> Callable[..., Any]:
        function = bpy.types.UILayout.bl_rna.functions[name]

        def record(*positional: Any, **named: Any) -> Any:
            parameters = function.parameters
            assert set(named) <= set(parameters.keys()), (name, named)
            icons = parameters["icon"].enum_items if "icon" in parameters else {}
            assert "icon" not in named or named["icon"] in icons, named
            label = positional[0].bl_rna.properties[positional[1]].name if name == "prop" else ""
            self.texts.append(named.get("text", label))
            self.icons.append(named.get("icon", "NONE"))
            if name in {"prop", "prop_search"}:
                assert positional[1] in positional[0].bl_rna.properties, positional
            if name == "operator":
                group, _, operator = positional[0].partition(".")
                rna = getattr(getattr(bpy.ops, group), operator).get_rna_type()
                return SimpleNamespace(**dict.fromkeys(rna.properties.keys()))
            return RecordingLayout(self.texts, self.icons)

        return record


def draw(addon: ModuleType) -> dict[str, list[str]]:
    """Draw all panels that show themselves, and return their texts by title."""
    drawn = {}
    for cls in addon.ui.classes:
        if issubclass(cls, bpy.types.Panel) and (not hasattr(cls, "poll") or cls.poll(bpy.context)):
            layout = RecordingLayout()
            panel = SimpleNamespace(layout=layout)
            for name in ("character_layout", "_draw_pin_groups"):
                if hasattr(cls, name):
                    setattr(panel, name, getattr(cls, name).__get__(panel))
            cls.draw(panel, bpy.context)
            drawn[cls.bl_label] = layout.texts
    return drawn


def test_nothing_selected(addon: ModuleType) -> None:
    assert draw(addon) == {"Followthrough": ["Select a skinned mesh"]}


def test_an_object_that_is_no_mesh(addon: ModuleType) -> None:
    bpy.ops.object.camera_add()
    assert draw(addon) == {"Followthrough": ["Select a skinned mesh"]}


def test_a_stopped_bake_changes_the_button(
    addon: ModuleType, painted: bpy.types.Object, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(bake_recovery, "SAVE_INTERVAL", 0.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    settings = addon.properties.bake_settings
    bake = addon.bake.session.BakeSession(
        bpy.context.scene, {painted.name: settings.object_settings(painted)}, settings.frame_range(painted)
    )
    while bake.done < 6:
        bake.advance(0.0)
    bake.cancel()
    assert "Resume Baking from Frame 6" in draw(addon)["Followthrough"]
    painted.followthrough.frequency_soft *= 1.5
    assert "Bake 12 Frames" in draw(addon)["Followthrough"]
    painted.followthrough.frequency_soft /= 1.5
    assert bpy.ops.followthrough.discard_stopped_bake() == {"FINISHED"}
    assert "Bake 12 Frames" in draw(addon)["Followthrough"]


def test_an_armature_offers_its_meshes(addon: ModuleType, character: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = character.parent
    (texts,) = draw(addon).values()
    assert "Column" in texts


def test_a_mesh_without_armature(addon: ModuleType) -> None:
    bpy.ops.mesh.primitive_cube_add()
    (texts,) = draw(addon).values()
    assert "armature" in " ".join(texts)


def test_a_character_before_and_after_add(addon: ModuleType, character: bpy.types.Object) -> None:
    assert list(draw(addon)) == ["Followthrough"]
    bpy.ops.followthrough.add()
    assert list(draw(addon)) == ["Followthrough", "Paint", "Motion", "Learned Springs", "Frames", "Volume"]
    assert "Bake 12 Frames" in draw(addon)["Followthrough"]


def test_a_linked_mesh(addon: ModuleType, painted: bpy.types.Object, tmp_path: Any) -> None:
    path = str(tmp_path / "library.blend")
    bpy.data.libraries.write(path, {painted})
    bpy.ops.wm.read_factory_settings(use_empty=True)
    with bpy.data.libraries.load(path, link=True) as (_there, here):
        here.objects = ["Column"]
    bpy.context.scene.collection.objects.link(bpy.data.objects["Column"])
    bpy.context.view_layer.objects.active = bpy.data.objects["Column"]
    assert "linked" in " ".join(draw(addon)["Followthrough"])
    assert not bpy.ops.followthrough.bake.poll()


def test_a_linked_mesh_on_a_local_object_is_baked_to_a_point_cache(
    addon: ModuleType, character: bpy.types.Object, tmp_path: Path
) -> None:
    frames = bpy.context.scene.frame_start, bpy.context.scene.frame_end
    obj = make_local(link_into_new_file(addon, character, tmp_path))
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = frames
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert obj.data.library is not None
    (texts,) = draw(addon).values()
    assert "Point Cache" in " ".join(texts)
    obj.followthrough.output = "pc2"
    assert bpy.ops.followthrough.add() == {"FINISHED"}
    assert "Output" in draw(addon)["Frames"]
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    assert f"Baked {frames[0]} to {frames[1]}" in draw(addon)["Followthrough"]
    assert obj.modifiers[0].type == "MESH_CACHE"
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert [modifier.type for modifier in obj.modifiers] == ["ARMATURE"]


@pytest.mark.parametrize("target", ["STIFFNESS", "MASS", "PINS"])
def test_painting_shows_what_the_values_mean(addon: ModuleType, painted: bpy.types.Object, target: str) -> None:
    bpy.ops.followthrough.paint(target=target)
    assert addon.painting.paint.MEANINGS[target] in draw(addon)["Paint"]


@pytest.mark.parametrize("target", ["STIFFNESS", "MASS", "PINS"])
def test_the_tooltips_of_painting(addon: ModuleType, target: str) -> None:
    """Blender asks for them with the operator's class, as here."""
    operator = addon.painting.paint.FOLLOWTHROUGH_OT_paint
    tooltip = operator.description(bpy.context, SimpleNamespace(target=target))
    assert tooltip.startswith("Paint where the character")
    assert tooltip.endswith(addon.painting.paint.MEANINGS[target])


def test_remove_is_in_the_title(addon: ModuleType, character: bpy.types.Object) -> None:
    header = addon.ui.main_panel.FOLLOWTHROUGH_PT_main.draw_header_preset
    layouts = [RecordingLayout(), RecordingLayout()]
    header(SimpleNamespace(layout=layouts[0]), bpy.context)
    bpy.ops.followthrough.add()
    header(SimpleNamespace(layout=layouts[1]), bpy.context)
    assert [layout.icons for layout in layouts] == [[], ["X"]]


def test_an_action_that_is_not_there_is_told(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.followthrough.frame_range = "ACTION"
    assert "Bake 12 Frames" in draw(addon)["Followthrough"]
    painted.parent.animation_data_clear()
    assert any("plays no action" in text for text in [" ".join(draw(addon)["Followthrough"])])


def test_every_solver_shows_its_own_settings(addon: ModuleType, painted: bpy.types.Object) -> None:
    texts = {}
    for solver in ("springs", "emulator", "implicit-euler"):
        painted.followthrough.solver = solver
        texts[solver] = draw(addon)["Motion"]
    texts = {solver: [text for text in found if text] for solver, found in texts.items()}
    texts["springs"] = [text.removesuffix(" (Hz)") for text in texts["springs"]]  # before Blender 4.5
    assert texts["springs"] == ["Solver", "Softest", "Stiffest", "Damping", "Gravity", "Amplitude"]
    flesh = ["Softest (kPa)", "Stiffest (kPa)", "Damping", "Gravity", "Amplitude"]
    assert texts["emulator"][1:] == [*flesh, "Corrections", "Weights"]
    assert texts["implicit-euler"][1:] == [*flesh, "Quality"]


def test_what_the_emulator_cannot_do_is_said_above_the_button(
    addon: ModuleType, painted: bpy.types.Object, tmp_path: Any
) -> None:
    painted.followthrough.solver = "emulator"
    painted.followthrough.weights = str(tmp_path / "nowhere.npz")
    texts = draw(addon)["Followthrough"]
    assert "found no such file" in " ".join(texts)
    assert texts[-1] == "Bake 12 Frames"
    painted.followthrough.solver = "springs"
    assert draw(addon)["Followthrough"] == ["", "Preview", "", "Bake 12 Frames"]


def test_every_choice_of_frames(addon: ModuleType, painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.use_loop, settings.frame_range = True, "CUSTOM"
    settings.frame_start, settings.frame_end = 3, 6
    texts = draw(addon)
    assert "Bake 4 Frames" in texts["Followthrough"]
    assert {"First", "Last"} <= set(texts["Frames"])


def test_the_bake_button_is_the_status_line(addon: ModuleType, painted: bpy.types.Object) -> None:
    settings = addon.properties.bake_settings
    bake = addon.bake.session.BakeSession(bpy.context.scene, {"Column": settings.object_settings(painted)})
    bake.advance(0.0)
    assert any(text.startswith("Baking frame 2 of ") for text in draw(addon)["Followthrough"])
    bake.cancel()
    bpy.ops.followthrough.bake()
    assert "Baked 1 to 12" in draw(addon)["Followthrough"]


def test_a_pin_group_that_is_missing_is_marked(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.vertex_groups.clear()
    layout = RecordingLayout()
    pin = painted.followthrough.pin_groups[0]
    addon.ui.lists.FOLLOWTHROUGH_UL_pin_groups.draw_item(
        None, bpy.context, layout, painted.followthrough, pin, 0, None, ""
    )
    assert "Pins" in layout.texts
    assert "ERROR" in layout.icons
    assert draw(addon)["Paint"]


def test_a_group_that_is_gone_is_told_where_it_is_painted(addon: ModuleType, painted: bpy.types.Object) -> None:
    before = draw(addon)
    painted.vertex_groups["Followthrough Stiffness"].name = "Stiff"
    told = " ".join(draw(addon)["Paint"])
    assert "No vertex group 'Followthrough Stiffness'" in told
    assert "Followthrough Mass" not in told
    assert bpy.ops.followthrough.paint(target="STIFFNESS") == {"FINISHED"}
    bpy.ops.followthrough.finish_painting()
    assert draw(addon) == before
    bpy.ops.followthrough.remove()
    assert painted.vertex_groups.keys() == ["lower", "upper", "Stiff"]


def test_what_is_missing_for_a_bake_is_said_above_the_button(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.followthrough.solver = "emulator"
    painted.vertex_groups.remove(painted.vertex_groups["Followthrough Pins"])
    texts = draw(addon)["Followthrough"]
    told = " ".join(texts)
    assert "no vertex group 'Followthrough Pins'" in told
    assert "" not in texts[texts.index("Preview") + 1 : -2], "Use Simulation is no answer to that"
    painted.followthrough.pin_groups.clear()
    painted.followthrough.solver = "springs"
    painted.hide_set(True)
    assert "is hidden" in " ".join(draw(addon)["Followthrough"])


def test_one_frame_is_no_frames(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.context.scene.frame_end = 1
    assert "Bake 1 Frame" in draw(addon)["Followthrough"]


def test_learned_springs_are_for_the_solver_springs(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.learn()
    painted.followthrough.solver = "springs"
    plain = draw(addon)["Learned Springs"]
    painted.followthrough.solver = "emulator"
    assert "choose them under" in " ".join(draw(addon)["Learned Springs"])
    assert "choose them under" not in " ".join(plain)
