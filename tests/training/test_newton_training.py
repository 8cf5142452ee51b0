# SPDX-License-Identifier: GPL-3.0-or-later
"""Training of the guides of Newton steps on a small bar, and that PyTorch and the core do the same with them."""

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from followthrough import cli
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.evaluation import evaluate
from followthrough.newton_patches import NewtonPatches
from followthrough.simulation import simulate
from followthrough.training.newton_examples import NewtonDataSet
from followthrough.training.newton_network import Frame, GuidedNewtonNetwork
from followthrough.training.settings import NewtonSettings
from followthrough.training.trainer import Trainer

sys.path.insert(0, str(Path(__file__).parent))
from test_training import bar

SMALL = {
    "iterations": (2, 2),
    "widths": (8,),
    "frames_a_step": 2,
    "warmup_steps": 5,
    "most_passes": 2,
    "tolerance": 0.0,
}

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for k, modulus in enumerate((2e5, 5e5, 1e6)):
        bar(modulus, 0.7 * k).save(folder / f"bar-{k}.npz")
    return folder


@pytest.fixture(scope="module")
def data(folder: Path) -> NewtonDataSet:
    return NewtonDataSet.load([folder])


def trained(data: NewtonDataSet, steps: int) -> Trainer:
    trainer = Trainer(data, NewtonSettings(**SMALL, steps=steps, average=0.98), TrainedOn())
    while trainer.step < steps:
        trainer.take_step()
    return trainer


def test_guides_learn_and_their_weights_run(data: NewtonDataSet) -> None:
    held_out = bar(3e5, 2.0)
    before, after = (
        evaluate(held_out, Emulator.of_sequence(held_out, trained(data, steps).weights())) for steps in (1, 400)
    )
    assert after.single_frame < 0.7 * before.single_frame
    assert math.isfinite(after.rollout_all)


def test_pytorch_and_the_core_agree_after_a_hundred_frames(data: NewtonDataSet) -> None:
    network = trained(data, 30).average
    motion = bar(4e5, 1.0, frames=101)
    native = simulate(motion, Emulator.of_sequence(motion, network.to_weights())).dynamic
    assert native is not None
    scene = NewtonPatches.of_sequence(motion)
    x, frames = motion.reference, [motion.reference[0]] * 4
    with torch.no_grad():
        for t in range(1, len(x)):
            past = [max(t - k, 0) for k in range(4)]
            network([scene], [Frame(np.array(frames[:-5:-1]), x[past])])
            frames.append(scene.estimate())
    np.testing.assert_allclose(frames[-1], native[-1], rtol=0, atol=1e-5)
    assert np.abs(native[-1] - x[-1]).max() > 1e-3


def test_a_run_that_was_stopped_ends_as_one_that_was_not(data: NewtonDataSet, tmp_path: Path) -> None:
    settings = NewtonSettings(**SMALL, steps=20)
    whole = Trainer(data, settings, TrainedOn())
    whole.run(tmp_path / "whole.pt")
    stopped = Trainer(data, settings, TrainedOn())
    for _ in range(7):
        stopped.take_step()
    stopped.save_checkpoint(tmp_path / "stopped.pt")
    resumed = Trainer(data, settings, TrainedOn())
    resumed.run(tmp_path / "stopped.pt")
    assert resumed.losses == whole.losses
    with pytest.raises(ValueError, match=r"found a run with widths \[8\], expected \[9\]"):
        Trainer(data, replace(settings, widths=(9,)), TrainedOn()).resume(tmp_path / "whole.pt")


def test_the_command_trains_guides_where_nothing_else_is_said(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "weights.npz"
    assert cli.main(["train", str(folder), "-o", str(output), "--steps", "3", "--quiet", "--device", "cpu"]) == 0
    weights = EmulatorWeights.load(output)
    assert weights.network == "guided-newton"
    assert weights.manifest["settings"]["architecture"] == "guided-newton"
    again = GuidedNewtonNetwork.from_weights(weights).to_weights()
    for name, array in weights.parameters.items():
        np.testing.assert_array_equal(again.parameters[name], array)
    config = tmp_path / "changed.toml"
    for line, message in (
        ("widths = []", "widths: found []"),
        ("iterations = [-1]", "iterations: found -1"),
        ("tolerance = -1.0", "tolerance: found -1.0"),
        ("evenness = 2.0", "evenness: found 2.0"),
        ("rings = 2", "found unknown rings"),
    ):
        config.write_text(line)
        assert cli.main(["train", str(folder), "--config", str(config), "-o", str(tmp_path / "w.npz")]) == 2
        assert message in capsys.readouterr().err
