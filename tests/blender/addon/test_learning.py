# SPDX-License-Identifier: GPL-3.0-or-later
"""Learn from Simulation, the heat map, and how they are taken back."""

import itertools
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough.blender import has_learned, read_learned
from followthrough.spring_heat_map import heat_map

from .test_panels import draw

ATTRIBUTE = "Followthrough Heat Map"


@pytest.fixture
def learned(painted: bpy.types.Object) -> bpy.types.Object:
    """A character that has learned from its twelve frames."""
    assert bpy.ops.followthrough.learn() == {"FINISHED"}
    return painted


def colours(obj: bpy.types.Object) -> NDArray[np.float32]:
    values = np.empty(4 * len(obj.data.vertices), dtype=np.float32)
    obj.data.color_attributes[ATTRIBUTE].data.foreach_get("color_srgb", values)
    return values.reshape(-1, 4)[:, :3]


def baked(obj: bpy.types.Object) -> NDArray[np.float32]:
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    blocks = obj.data.shape_keys.key_blocks
    out = np.empty((len(blocks), len(obj.data.vertices) * 3), dtype=np.float32)
    for row, block in zip(out, blocks, strict=True):
        block.points.foreach_get("co", row)
    return out[1:] - out[0]


def test_learn_keeps_springs_that_the_bake_uses(painted: bpy.types.Object) -> None:
    plain = baked(painted)
    assert bpy.ops.followthrough.learn() == {"FINISHED"}
    assert has_learned(painted)
    assert bpy.context.scene.frame_current == 3
    with_learned = baked(painted)
    assert np.abs(with_learned - plain).max() > 1e-3
    painted.followthrough.use_learned = False
    assert np.array_equal(baked(painted), plain)
    painted.followthrough.use_learned = True
    painted.followthrough.frequency_stiff = 40.0
    assert not np.array_equal(baked(painted), with_learned)


def test_the_range_is_the_artists(painted: bpy.types.Object) -> None:
    assert (painted.followthrough.learn_start, painted.followthrough.learn_end) == (1, 12)
    painted.followthrough.learn_end = 4
    with pytest.raises(RuntimeError, match="4 frames are too few: take 10 or more to learn from, First to Last"):
        bpy.ops.followthrough.learn()
    painted.followthrough.learn_end = -3
    assert painted.followthrough.learn_start == -3
    assert not has_learned(painted)


def test_learning_in_a_window_can_be_cancelled(addon: ModuleType, painted: bpy.types.Object) -> None:
    operator = addon.learning.operator.FOLLOWTHROUGH_OT_learn
    settings = addon.properties.bake_settings.object_settings(painted)
    session = addon.bake.session.BakeSession(
        bpy.context.scene,
        {painted.name: settings},
        None,
        addon.learning.operator.Learning,
        "Learning, step",
        "Keeping springs",
    )
    assert not bpy.ops.followthrough.learn.poll()
    assert not bpy.ops.followthrough.bake.poll()
    session.advance(0.0)
    assert session.status().startswith("Learning, step 2 of 13")
    assert "Learning, step" in " ".join(draw(addon)["Followthrough"]) or session.done
    session.cancel()
    assert addon.bake.running() is None
    assert not has_learned(painted)
    assert bpy.context.scene.frame_current == 3
    assert issubclass(operator, addon.bake.operator.StepwiseOperator)


def test_the_panel_offers_what_there_is(addon: ModuleType, painted: bpy.types.Object) -> None:
    before = draw(addon)["Learned Springs"]
    assert "Heat Map" not in before
    bpy.ops.followthrough.learn()
    after = draw(addon)["Learned Springs"]
    assert {"Use Learned", "Heat Map", "Stiffness", "Damping", "Regime"} <= set(after)
    bpy.ops.followthrough.show_heat_map(quantity="damping")
    assert len(draw(addon)["Learned Springs"]) == len(after) + 1  # Hide


@pytest.mark.parametrize("quantity", ["stiffness", "damping", "regime"])
def test_the_heat_map_colours_what_was_learned(addon: ModuleType, learned: bpy.types.Object, quantity: Any) -> None:
    assert bpy.ops.followthrough.show_heat_map(quantity=quantity) == {"FINISHED"}
    springs = read_learned(learned)
    assert springs is not None
    expected = heat_map(quantity, springs.stiffness, springs.damping, springs.known)
    assert np.abs(colours(learned) - expected.colours()).max() < 1 / 200
    assert learned.data.color_attributes.active_color.name == ATTRIBUTE
    assert addon.learning.heat_map.shown_quantity(learned) == quantity


def test_the_legend_is_the_scale(addon: ModuleType, learned: bpy.types.Object) -> None:
    legend = addon.learning.legend
    addon.learning.heat_map.show(learned, "stiffness")
    shown = addon.learning.heat_map.shown_scale(learned)
    stripes = legend.stripes(shown, 2.0)
    assert all(above.corners[1] == below.corners[3] for below, above in itertools.pairwise(stripes))
    assert stripes[0].colour != stripes[-1].colour
    texts = [text for _, _, text in legend.labels(shown, 2.0)]
    assert texts == [
        f"{shown.low:.1f}",
        f"{(shown.low + shown.high) / 2:.1f}",
        f"{shown.high:.1f}",
        "Stiffness, log10 ks (1/s²)",
    ]
    aside = legend.stripes(shown, 2.0, left=50.0)
    assert aside[0].corners[0] == stripes[0].corners[0] + 50.0
    addon.learning.heat_map.show(learned, "regime")
    texts = [text for _, _, text in legend.labels(addon.learning.heat_map.shown_scale(learned), 1.0)]
    assert texts[0].endswith("swings")
    assert texts[2].endswith("creeps")


def test_hiding_takes_the_colours_off(learned: bpy.types.Object) -> None:
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    assert bpy.ops.followthrough.hide_heat_map() == {"FINISHED"}
    assert ATTRIBUTE not in learned.data.color_attributes
    assert not bpy.ops.followthrough.hide_heat_map.poll()
    assert has_learned(learned)


def viewport() -> bpy.types.SpaceView3D:
    return next(area.spaces.active for area in bpy.context.screen.areas if area.type == "VIEW_3D")


def legend(addon: ModuleType) -> Any:
    return addon.learning.legend.legend_in(viewport(), bpy.context)


def test_undo_takes_the_legend_and_the_viewports_colours_along(addon: ModuleType, learned: bpy.types.Object) -> None:
    before = viewport().shading.color_type
    bpy.ops.ed.undo_push(message="Before")
    bpy.ops.followthrough.show_heat_map(quantity="stiffness")
    bpy.ops.ed.undo_push(message="Stiffness")
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    bpy.ops.ed.undo_push(message="Regime")
    assert legend(addon).quantity == "regime"
    bpy.ops.ed.undo()
    assert legend(addon).quantity == "stiffness"
    assert viewport().shading.color_type == "VERTEX"
    bpy.ops.ed.undo()
    assert legend(addon) is None
    assert viewport().shading.color_type == before
    bpy.ops.ed.redo()
    assert legend(addon).quantity == "stiffness"


def test_the_legend_is_there_again_when_the_file_is(
    addon: ModuleType, learned: bpy.types.Object, tmp_path: Path
) -> None:
    bpy.ops.followthrough.show_heat_map(quantity="damping")
    shown = legend(addon)
    learned.name = "Renamed"
    assert legend(addon) == shown
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    viewport().shading.color_type = "VERTEX"  # where the file's own screens are not opened with it
    assert legend(addon) == shown


def test_no_legend_where_the_colours_are_not_seen(addon: ModuleType, learned: bpy.types.Object) -> None:
    bpy.ops.followthrough.show_heat_map(quantity="damping")
    bpy.ops.followthrough.paint(target="MASS")
    assert legend(addon) is None
    bpy.ops.followthrough.finish_painting()
    assert legend(addon) is not None
    viewport().shading.type = "MATERIAL"
    assert legend(addon) is None


@pytest.mark.parametrize("take_off", ["hide_heat_map", "forget_learned", "remove"])
def test_what_a_viewport_showed_before_is_back(learned: bpy.types.Object, take_off: str) -> None:
    viewport().shading.color_type = "RANDOM"
    viewport().shading.type = "MATERIAL"
    bpy.ops.followthrough.show_heat_map(quantity="damping")
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    assert (viewport().shading.type, viewport().shading.color_type) == ("SOLID", "VERTEX")
    getattr(bpy.ops.followthrough, take_off)()
    assert viewport().shading.type == "MATERIAL"
    viewport().shading.type = "SOLID"
    assert viewport().shading.color_type == "RANDOM"


def test_the_active_colours_are_active_again(learned: bpy.types.Object) -> None:
    attributes = learned.data.color_attributes
    for name in ("First", "Second", "Third"):
        attributes.new(name, "BYTE_COLOR", "POINT")
    attributes.active_color_index = 1
    bpy.ops.followthrough.show_heat_map(quantity="damping")
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    bpy.ops.followthrough.hide_heat_map()
    assert attributes.active_color.name == "Second"


def test_learning_again_colours_anew(learned: bpy.types.Object) -> None:
    bpy.ops.followthrough.show_heat_map(quantity="stiffness")
    before = colours(learned)
    learned.followthrough.modulus_soft = learned.followthrough.modulus_stiff = 100.0
    bpy.ops.followthrough.learn()
    after = colours(learned)
    assert not np.array_equal(before, after)
    bpy.ops.followthrough.show_heat_map(quantity="stiffness")
    assert np.array_equal(after, colours(learned))


def test_forgetting_goes_back_to_paint(painted: bpy.types.Object) -> None:
    plain = baked(painted)
    bpy.ops.followthrough.learn()
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    assert bpy.ops.followthrough.forget_learned() == {"FINISHED"}
    assert not has_learned(painted)
    assert ATTRIBUTE not in painted.data.color_attributes
    assert not bpy.ops.followthrough.forget_learned.poll()
    assert not bpy.ops.followthrough.show_heat_map.poll()
    assert np.array_equal(baked(painted), plain)


def test_remove_takes_what_was_learned_with_it(character: bpy.types.Object) -> None:
    def state() -> Any:
        return sorted(character.data.attributes.keys()), sorted(character.data.keys()), sorted(character.keys())

    before = state()
    bpy.ops.followthrough.add()
    character.followthrough.cells = 8
    bpy.ops.followthrough.learn()
    bpy.ops.followthrough.show_heat_map(quantity="stiffness")
    assert state() != before
    bpy.ops.followthrough.remove()
    assert state() == before


def test_an_attribute_of_others_is_no_spring(learned: bpy.types.Object) -> None:
    learned.data.attributes.remove(learned.data.attributes["Followthrough kd"])
    learned.data.attributes.new("Followthrough kd", "INT", "FACE")
    assert not has_learned(learned)
    assert bpy.ops.followthrough.learn() == {"FINISHED"}
    assert has_learned(learned)
