# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that the emulator is scored on, and the command that does it."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from followthrough.benchmarking.hard_scenes import HALVES, SCENES, Scene, half
from followthrough.emulator_weights import EmulatorWeights
from followthrough.sequences import Sequence


@pytest.fixture(scope="module")
def command() -> Iterator[ModuleType]:
    path = Path(__file__).parents[2] / "cpp" / "bench" / "emulator_scenes.py"
    spec = importlib.util.spec_from_file_location("emulator_scenes", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(path.parent)  # scripts there import each other
        patch.setitem(sys.modules, "emulator_scenes", module)
        spec.loader.exec_module(module)
        yield module


def test_every_scene_is_in_one_half() -> None:
    names = [scene.name for which in HALVES for scene in half(which)]
    assert len(set(names)) == len(names)
    assert sorted(names) == sorted(scene.name for scene in SCENES)
    with pytest.raises(ValueError, match="expected choose or report"):
        half("both")


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name)
def test_scenes_move_and_are_the_same_each_time(scene: Scene) -> None:
    first, second = (replace(scene, frames=40).sequence() for _ in range(2))
    np.testing.assert_array_equal(first.reference, second.reference)
    assert (~first.constrained).any()
    assert np.ptp(first.reference, axis=0).max() > 0.1


def test_scores_a_scene_beside_the_simulation_with_its_truth_kept(command: ModuleType, tmp_path: Path) -> None:
    scene = Scene("hanging", "swing", frames=6)
    compared = command.methods(EmulatorWeights.shipped())
    scores = command.measure(scene, tmp_path, compared)
    assert list(scores) == ["emulator", "preview", "fine"]
    assert scores["emulator"].single_frame < 0.003
    assert "–" in command.row(scene, scores)
    assert "1 of 1" in command.summary([scores])
    path = tmp_path / f"{scene.name}.npz"
    kept = Sequence.load(path)
    assert kept.dynamic is not None
    replace(kept, dynamic=kept.dynamic + 1.0).save(path)
    assert command.measure(scene, tmp_path, compared)["emulator"].rollout_all > 0.5  # what is kept counts
    replace(kept, reference=kept.reference + 1.0).save(path)
    np.testing.assert_array_equal(
        command.truth_of(scene, tmp_path).dynamic, kept.dynamic
    )  # of another scene: made again
