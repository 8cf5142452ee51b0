# SPDX-License-Identifier: GPL-3.0-or-later
"""Training runs on a small bar: what they learn, and that a killed one continues to the same end."""

import json
import math
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from elastic_scenes import swinging_bar

from followthrough import cli
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.evaluation import evaluate
from followthrough.training.examples import DataSet
from followthrough.training.settings import TrainingSettings
from followthrough.training.trainer import Trainer

SMALL = {
    "inertia": (16, 16, 16),
    "force": (24, 24, 24),
    "displacement": (32, 32),
    "frames_a_step": 8,
    "vertices_a_frame": 12,
}

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    for k, modulus in enumerate((2e5, 1e6)):
        swinging_bar(modulus, 0.7 * k).save(folder / f"bar-{k}.npz")
    return folder


@pytest.fixture(scope="module")
def data(folder: Path) -> DataSet:
    return DataSet.load([folder], TrainedOn(), rings=1)


def test_a_network_learns_and_its_weights_run(data: DataSet) -> None:
    settings = TrainingSettings(**SMALL, steps=600, learning_rate=3e-3, warmup_steps=20, average=0.98, noise=0.001)
    held_out = swinging_bar(5e5, 2.0)
    trainer = Trainer(data, settings, TrainedOn(), [held_out])
    before = trainer.measure()
    while trainer.step < settings.steps:
        trainer.take_step()
    after = trainer.measure()
    assert before is not None and after is not None
    assert np.mean(trainer.losses[-50:]) < 0.05 * np.mean(trainer.losses[:10])
    weights = trainer.weights()
    assert weights.trained_on.stiffness_range == pytest.approx((5, 25))
    assert weights.manifest["steps"] == 600
    scores = evaluate(held_out, Emulator.of_sequence(held_out, weights))
    assert scores.single_frame == pytest.approx(after.single_frame)
    assert held_out.dynamic is not None
    still = np.sqrt(np.mean((held_out.dynamic[1:] - held_out.dynamic[:-1]) ** 2))
    assert scores.single_frame < 0.35 * still
    assert math.isfinite(scores.rollout_all)


def test_batches_have_their_true_changes(data: DataSet) -> None:
    settings = TrainingSettings(**SMALL, noise=0.0)
    batch, changes = data.batch(settings, 5)
    again, same = data.batch(settings, 5)
    assert torch.equal(batch.dynamic, again.dynamic) and torch.equal(changes, same)
    assert not torch.equal(data.batch(settings, 6)[1][:10], changes[:10])
    assert len(changes) == 8 * 12
    noisy, noisy_changes = data.batch(replace(settings, noise=0.01), 5)
    free = ~batch.constrained
    shift = noisy.dynamic - batch.dynamic
    assert torch.equal(shift[:, ~free], torch.zeros_like(shift[:, ~free]))
    assert shift[:, free].std() == pytest.approx(0.01, rel=0.1)
    torch.testing.assert_close(
        noisy_changes + noisy.dynamic[0, noisy.centres], changes + batch.dynamic[0, batch.centres]
    )


@pytest.mark.parametrize("optimizer", ["adamw", "muon"])
def test_a_run_that_was_stopped_ends_as_one_that_was_not(data: DataSet, tmp_path: Path, optimizer: str) -> None:
    settings = TrainingSettings(**SMALL, steps=30, warmup_steps=5, optimizer=optimizer)
    whole = Trainer(data, settings, TrainedOn())
    whole.run(tmp_path / "whole.pt")
    stopped = Trainer(data, settings, TrainedOn())
    for _ in range(11):
        stopped.take_step()
    stopped.save_checkpoint(tmp_path / "stopped.pt")
    resumed = Trainer(data, settings, TrainedOn())
    resumed.run(tmp_path / "stopped.pt")
    assert resumed.losses == whole.losses
    for name, tensor in whole.average.state_dict().items():
        assert torch.equal(resumed.average.state_dict()[name], tensor)
    other = Trainer(data, replace(settings, noise=0.5), TrainedOn())
    with pytest.raises(ValueError, match=r"found a run with noise 0\.002, expected 0\.5"):
        other.resume(tmp_path / "whole.pt")
    (tmp_path / "whole.pt").write_bytes((tmp_path / "whole.pt").read_bytes()[:1000])
    with pytest.raises(ValueError, match="no readable checkpoint"):
        whole.resume(tmp_path / "whole.pt")


@pytest.mark.parametrize("biases", [True, False])
def test_muon_takes_matrices_and_adamw_takes_biases(data: DataSet, biases: bool) -> None:
    settings = TrainingSettings(**SMALL, steps=10, warmup_steps=0, learning_rate=0.01, optimizer="muon", biases=biases)
    trainer = Trainer(data, settings, TrainedOn())
    before = {name: tensor.clone() for name, tensor in trainer.network.state_dict().items()}
    trainer.take_step()
    assert any(tensor.ndim == 1 for tensor in before.values()) == biases
    for name, tensor in trainer.network.state_dict().items():
        step = tensor - before[name]
        if step.ndim == 1:  # Adam's first step is the learning rate, whatever the gradient
            torch.testing.assert_close(step.abs(), torch.full_like(step, settings.learning_rate), rtol=1e-3, atol=0)
        else:
            largest = torch.linalg.svdvals(step).max()
            assert largest == pytest.approx(0.2 * settings.learning_rate * math.sqrt(max(step.shape)), rel=0.4), name


def config(path: Path, **changes: object) -> Path:
    values = {"architecture": "patch", **SMALL, "warmup_steps": 5, **changes}
    path.write_text(
        "\n".join(f"{key} = {json.dumps(list(v) if isinstance(v, tuple) else v)}" for key, v in values.items())
    )
    return path


def test_the_command_trains_and_continues_after_a_kill(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, output = config(tmp_path / "small.toml"), tmp_path / "weights.npz"
    command = ["train", str(folder), "--config", str(settings), "-o", str(output), "--steps", "40", "--device", "cpu"]
    code = (
        "import sys, torch; torch.set_num_threads(1); from followthrough.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    slow = [*command, "--checkpoint-minutes", "0", "--quiet"]
    slow[slow.index("40")] = "100000"
    process = subprocess.Popen([sys.executable, "-c", code, *slow])
    checkpoint = tmp_path / "weights.checkpoint.pt"
    deadline = time.monotonic() + 300
    while not checkpoint.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not output.exists()
    steps = torch.load(checkpoint, weights_only=True)["step"]
    assert steps > 0
    slow[slow.index("100000")] = str(steps + 3)
    assert cli.main(slow) == 2  # the schedule depends on the number of steps
    assert "found a run with steps 100000" in capsys.readouterr().err
    checkpoint.unlink()
    assert cli.main([*command, "--quiet", "--validation", str(folder)]) == 0
    said = capsys.readouterr().out
    assert "after 40 steps" in said and "validation: single frame" in said
    assert output.with_suffix(".png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    weights = EmulatorWeights.load(output)
    assert weights.manifest["settings"]["force"] == [24, 24, 24]
    assert cli.main([*command, "--quiet"]) == 0  # nothing is left to do
    assert "continuing after step 40" in capsys.readouterr().err


def test_settings_that_do_not_fit_are_refused(tmp_path: Path, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for changes, message in (
        ({"architecture": "mlp"}, "architecture: found 'mlp', expected guided-newton or patch"),
        ({"colour": 3}, "found unknown colour"),
        ({"steps": 1.5}, "steps: found 1.5"),
        ({"rings": 4}, "rings: found 4, expected 1 to 3"),
        ({"force": (128,)}, "fewer than two layers"),
        ({"average": 2.0}, "average: found 2.0"),
        ({"inertia": (0, 3)}, "inertia: found [0, 3]"),
        ({"optimizer": "sgd"}, "optimizer: found 'sgd', expected adamw or muon"),
    ):
        path = config(tmp_path / "changed.toml", **changes)
        assert cli.main(["train", str(folder), "--config", str(path), "-o", str(tmp_path / "w.npz")]) == 2
        assert message in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    assert cli.main(["train", str(tmp_path / "empty"), "-o", str(tmp_path / "w.npz")]) == 2
    assert "found no sequences" in capsys.readouterr().err
