# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator in the panel: which solver a file has, what is beyond it, and the way out."""

from pathlib import Path
from types import ModuleType

import bpy
import pytest
from plain_network import random_parameters

from followthrough import emulator_weights
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.settings import EmulatorSettings


def save_weights(path: Path, low: float = 0.01, high: float = 1e4) -> Path:
    small = random_parameters(0, inertia=(8, 8), force=(12, 8), displacement=(16,))
    EmulatorWeights(small, TrainedOn(stiffness_range=(low, high))).save(path)
    return path


@pytest.fixture(autouse=True)
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the weights of the package would be; there are none."""
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "emulator.npz")
    return tmp_path / "emulator.npz"


def test_add_chooses_the_solver_and_files_keep_it(character: bpy.types.Object, shipped: Path, tmp_path: Path) -> None:
    bpy.ops.followthrough.add()
    assert character.followthrough.solver == "springs"
    path = str(tmp_path / "springs.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    save_weights(shipped)
    bpy.ops.wm.open_mainfile(filepath=path)
    column = bpy.data.objects["Column"]
    assert column.followthrough.solver == "springs"
    bpy.ops.followthrough.remove()
    bpy.ops.followthrough.add()
    assert column.followthrough.solver == "emulator"


def test_files_of_older_versions_keep_their_solver(painted: bpy.types.Object, shipped: Path) -> None:
    """They know solvers by number, and leave the default of then unsaid."""
    items = painted.followthrough.bl_rna.properties["solver"].enum_items
    assert [item.identifier for item in items] == ["springs", "emulator", "implicit-euler"]
    assert (items["springs"].value, items["implicit-euler"].value) == (0, 1)
    save_weights(shipped)
    painted.followthrough.property_unset("solver")
    assert painted.followthrough.solver == "springs"


def test_what_is_set_reaches_the_library(addon: ModuleType, painted: bpy.types.Object, tmp_path: Path) -> None:
    settings = painted.followthrough
    motion = addon.properties.bake_settings.object_settings(painted).motion
    assert (motion.amplitude, motion.emulator) == (1.0, EmulatorSettings())
    settings.solver, settings.corrections, settings.weights = "emulator", 2, str(tmp_path / "mine.npz")
    settings.amplitude, settings.gravity = 1.5, 0.5
    motion = addon.properties.bake_settings.object_settings(painted).motion
    assert motion.solver == "emulator"
    assert motion.emulator == EmulatorSettings(weights=tmp_path / "mine.npz", corrections=2)
    assert motion.amplitude == 1.5
    assert motion.simulation.gravity == motion.springs.gravity == pytest.approx(4.905)


def test_it_bakes(painted: bpy.types.Object, shipped: Path) -> None:
    save_weights(shipped)
    painted.followthrough.solver = "emulator"
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    moved = painted.data.shape_keys.key_blocks["Followthrough 0008"]
    assert max((a.co - b.co).length for a, b in zip(moved.data, painted.data.vertices, strict=True)) > 1e-3


def test_what_it_has_not_learned_is_said_before_the_bake_and_simulation_is_a_click_away(
    addon: ModuleType, painted: bpy.types.Object, shipped: Path
) -> None:
    caution = addon.bake.cautions.caution_about
    scene, settings = bpy.context.scene, painted.followthrough
    save_weights(shipped, low=0.1)
    settings.solver = "emulator"
    assert caution(painted, scene) == ""
    assert bpy.ops.followthrough.use_simulation() == {"FINISHED"}
    assert settings.solver == "emulator"  # nothing is wrong with it here
    settings.modulus_soft = 0.01
    said = caution(painted, scene)
    assert "vertices are softer than the emulator has learned" in said
    settings.frame_end += 1  # asks no other question
    assert caution(painted, scene) == said
    scene.render.fps = 1  # so much stiffer in a frame
    assert "softer" not in caution(painted, scene)
    scene.render.fps = 24
    assert bpy.ops.followthrough.use_simulation() == {"FINISHED"}
    assert settings.solver == "implicit-euler"
    assert caution(painted, scene) == ""
    assert not bpy.ops.followthrough.use_simulation.poll()


def test_weights_that_are_missing_are_told_in_the_panel_and_refused_by_the_bake(
    addon: ModuleType, painted: bpy.types.Object
) -> None:
    painted.followthrough.solver = "emulator"
    assert "brings none for the emulator" in addon.bake.cautions.caution_about(painted, bpy.context.scene)
    with pytest.raises(RuntimeError, match="brings none for the emulator"):
        bpy.ops.followthrough.bake()
    assert painted.data.shape_keys is None
    painted.followthrough.weights = "//nowhere.npz"
    assert "found no such file" in addon.bake.cautions.caution_about(painted, bpy.context.scene)
    assert bpy.ops.followthrough.use_simulation() == {"FINISHED"}
    assert painted.followthrough.solver == "implicit-euler"


def test_paint_is_read_now_and_then_and_not_at_every_redraw(
    addon: ModuleType, painted: bpy.types.Object, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cautions = addon.bake.cautions
    save_weights(shipped)
    painted.followthrough.solver = "emulator"
    now, reads = [100.0], []

    def read(*arguments: object) -> str:
        reads.append(arguments)
        now[0] += 0.2  # seconds
        return "softer"

    monkeypatch.setattr(cautions, "_known", {})
    monkeypatch.setattr(cautions, "caution_before_bake", read)
    monkeypatch.setattr(cautions.time, "monotonic", lambda: now[0])
    for _ in range(10):
        assert cautions.caution_about(painted, bpy.context.scene) == "softer"
    assert len(reads) == 1
    now[0] += 4.1
    cautions.caution_about(painted, bpy.context.scene)
    assert len(reads) == 2
    bpy.ops.object.mode_set(mode="EDIT")  # which reading would have to leave
    now[0] += 100.0
    assert cautions.caution_about(painted, bpy.context.scene) == "softer"
    assert len(reads) == 2
