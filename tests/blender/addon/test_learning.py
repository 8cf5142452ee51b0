# SPDX-License-Identifier: GPL-3.0-or-later
"""Learn from Simulation, the heat map, and how they are taken back."""

import itertools
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
    with pytest.raises(RuntimeError, match="10 or more to learn from"):
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
    shown = addon.learning.heat_map.show(learned, "stiffness")
    stripes = legend.stripes(shown, 2.0)
    assert all(above.corners[1] == below.corners[3] for below, above in itertools.pairwise(stripes))
    assert stripes[0].colour != stripes[-1].colour
    texts = [text for _, _, text in legend.labels(shown, 2.0)]
    assert texts == [f"{shown.low:.1f}", f"{(shown.low + shown.high) / 2:.1f}", f"{shown.high:.1f}", "log10 ks (1/s²)"]


def test_hiding_takes_the_colours_off(learned: bpy.types.Object) -> None:
    bpy.ops.followthrough.show_heat_map(quantity="regime")
    assert bpy.ops.followthrough.hide_heat_map() == {"FINISHED"}
    assert ATTRIBUTE not in learned.data.color_attributes
    assert not bpy.ops.followthrough.hide_heat_map.poll()
    assert has_learned(learned)


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
