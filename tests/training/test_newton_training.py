# SPDX-License-Identifier: GPL-3.0-or-later
"""The guides of Newton steps: in PyTorch against the native ones, what they learn, and runs that are continued."""

import math
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
from followthrough.newton_patches import NewtonPatches
from followthrough.newton_weights import PASS_SIZE, START_SIZE, NewtonSchedule, guide_inputs
from followthrough.sequences import Sequence
from followthrough.simulation import simulate
from followthrough.training.network import PatchNetwork
from followthrough.training.newton_examples import NewtonDataSet
from followthrough.training.newton_network import Frame, GuidedNewtonNetwork
from followthrough.training.settings import NewtonSettings
from followthrough.training.trainer import Trainer

SMALL = {"iterations": (2, 3), "widths": (12, 8), "most_passes": 2, "tolerance": 0.0, "frames_a_step": 4}

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folders = []
    for k, modulus in enumerate((2e5, 5e5, 1e6)):
        folders.append(tmp_path_factory.mktemp("data"))
        swinging_bar(modulus, 0.7 * k).save(folders[-1] / "bar.npz")
    return folders


@pytest.fixture(scope="module")
def data(folders: list[Path]) -> NewtonDataSet:
    return NewtonDataSet.load(folders)


def shaken(network: GuidedNewtonNetwork, gain: float = 0.1) -> GuidedNewtonNetwork:
    """With last layers that say something."""
    with torch.no_grad():
        for guide in (network.start, *network.passes):
            guide[-1].weight += gain * torch.randn_like(guide[-1].weight)
            guide[-1].bias += gain * torch.randn_like(guide[-1].bias)
    return network


def native(network: GuidedNewtonNetwork, sequence: Sequence) -> np.ndarray:
    """The emulator's motion."""
    dynamic = simulate(sequence, Emulator.of_sequence(sequence, network.to_weights())).dynamic
    assert dynamic is not None
    return dynamic


def one_further(
    network: GuidedNewtonNetwork, scene: NewtonPatches, frames: np.ndarray, x: np.ndarray, repeats: int
) -> np.ndarray:
    """The frame after some."""
    t = len(frames) - 1
    past = [max(t - k, 0) for k in range(4)]
    taken = network([scene], [Frame(frames[past], x[[t + 1, *past[:3]]])], repeats)
    assert len(taken) == 1 + len(network.passes) + repeats
    if scene.end_passes():
        network.take_passes([scene], repeats)
        scene.end_passes()
    return scene.estimate()


@pytest.mark.parametrize(
    ("architecture", "repeats"),
    [
        ({"iterations": (4, 6), "most_passes": 2}, 0),
        ({"iterations": (5,), "widths": (7, 33, 16), "most_passes": 3}, 2),
        ({"iterations": (3, 2, 4), "widths": (1,), "most_passes": 4}, 1),
    ],
)
def test_every_frame_is_the_native_emulators(architecture: dict, repeats: int) -> None:
    torch.manual_seed(1)
    network = shaken(GuidedNewtonNetwork(**architecture, tolerance=0.0))
    sequence = swinging_bar(4e5, 0.3, frames=101)
    scene, expected = NewtonPatches.of_sequence(sequence), native(network, sequence)
    for t in range(100):  # each from the native ones before: so few iterations multiply what rounding does
        result = one_further(network, scene, expected[: t + 1], sequence.reference, repeats)
        np.testing.assert_allclose(result, expected[t + 1], rtol=0, atol=1e-5)
    assert 0.02 < np.abs(expected - sequence.reference).max() < 5
    usual = GuidedNewtonNetwork(**architecture, tolerance=0.0)
    assert np.abs(native(usual, sequence) - expected).max() > 0.005  # the guides have their say


def test_a_hundred_frames_agree_with_the_native_emulator() -> None:
    """Passes enough that it does not count where rounding ends conjugate gradients an iteration sooner."""
    torch.manual_seed(1)
    network = shaken(GuidedNewtonNetwork(iterations=(30, 30), most_passes=6, tolerance=0.0), gain=0.02)
    sequence = swinging_bar(4e5, 0.3, frames=101)
    scene, frames = NewtonPatches.of_sequence(sequence), sequence.reference[:1]
    for _ in range(100):
        frames = np.concatenate([frames, [one_further(network, scene, frames, sequence.reference, repeats=4)]])
    np.testing.assert_allclose(native(network, sequence), frames, rtol=0, atol=1e-5)
    assert 0.02 < np.abs(frames - sequence.reference).max() < 5


def test_scenes_of_a_batch_do_not_mix(data: NewtonDataSet) -> None:
    torch.manual_seed(2)
    network = shaken(GuidedNewtonNetwork(iterations=(4, 6)))
    scenes = [example.scene for example in data.examples]
    frames = [example.frame(10 + k)[0] for k, example in enumerate(data.examples)]
    together = network(scenes, frames, 1)
    assert len(together) == 4
    ends = np.cumsum([len(scene.free_vertices) for scene in scenes])[:-1]
    for k, (scene, frame) in enumerate(zip(scenes, frames, strict=True)):
        for (before, steps), ([own], alone) in zip(together, network([scene], [frame], 1), strict=True):
            np.testing.assert_allclose(before[k], own, rtol=0, atol=1e-7)
            np.testing.assert_allclose(
                np.split(steps.detach().numpy(), ends)[k], alone.detach().numpy(), rtol=0, atol=1e-5
            )


def test_before_it_has_learned_a_pass_is_its_direction(data: NewtonDataSet) -> None:
    network, example = GuidedNewtonNetwork(iterations=(5,)), data.examples[0]
    frame, _ = example.frame(8)
    (before, start), (_, step) = network([example.scene], [frame])
    scene = NewtonPatches.of_sequence(example.sequence)
    scene.begin(frame.dynamic, frame.reference)
    np.testing.assert_array_equal(before[0], scene.estimate())
    start_vectors = scene.start_features().vectors
    np.testing.assert_allclose(start.detach().numpy(), 0.5 * start_vectors[:, 0], rtol=0, atol=1e-6)
    scene.move(start.detach().numpy())
    scene.evaluate(5)
    np.testing.assert_allclose(step.detach().numpy(), scene.direction(), rtol=0, atol=1e-6)


def test_gradients_reach_every_parameter(data: NewtonDataSet) -> None:
    torch.manual_seed(3)
    settings = NewtonSettings(**SMALL)
    network = shaken(settings.network())
    data.loss(network, settings, 0, "cpu").backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.abs().max() > 0, name


def test_losses_are_those_of_the_steps_that_are_wanted(data: NewtonDataSet) -> None:
    settings = NewtonSettings(**SMALL, repeats=0, evenness=0.0)
    network = settings.network()
    losses = [data.loss(network, settings, step, "cpu").item() for step in (5, 5, 6)]
    assert losses[0] == losses[1] != losses[2]

    class Knowing(GuidedNewtonNetwork):
        """Takes nothing but right steps: the truth is where every pass begins."""

        def forward(self, scenes: list, frames: list, repeats: int = 0) -> list:
            truths = []
            for scene, frame in zip(scenes, frames, strict=True):
                example = next(example for example in data.examples if example.scene is scene)
                t = next(
                    t
                    for t in range(example.sequence.frame_count - 1)
                    if np.array_equal(example.frame(t)[0].reference, frame.reference)
                )
                truths.append(example.frame(t)[1])
            off = [np.full((len(scene.free_vertices), 3), 0.1, np.float32) for scene in scenes]
            return [(truths, torch.from_numpy(np.concatenate(off)))]

    assert data.loss(Knowing(), settings, 5, "cpu").item() == pytest.approx(0.03)


def test_guides_learn_and_their_weights_run(data: NewtonDataSet) -> None:
    settings = NewtonSettings(**SMALL, steps=400, learning_rate=5e-3, warmup_steps=20, average=0.98)
    held_out = swinging_bar(7e5, 2.0)
    trainer = Trainer(data, settings, TrainedOn(), [held_out])
    before = trainer.measure()
    while trainer.step < settings.steps:
        trainer.take_step()
    after = trainer.measure()
    assert before is not None and after is not None
    assert np.mean(trainer.losses[-50:]) < 0.6 * np.mean(trainer.losses[:10])
    assert after.single_frame < 0.6 * before.single_frame
    assert after.rollout_24 < 0.6 * before.rollout_24
    weights = trainer.weights()
    assert weights.network == "guided-newton"
    assert weights.trained_on.stiffness_range == pytest.approx((5, 25))
    assert weights.manifest["steps"] == 400
    assert weights.manifest["data"]["sequences"] == 3
    scores = evaluate(held_out, Emulator.of_sequence(held_out, weights))
    assert scores.single_frame == pytest.approx(after.single_frame)


def test_a_run_that_was_stopped_ends_as_one_that_was_not(data: NewtonDataSet, tmp_path: Path) -> None:
    settings = NewtonSettings(**SMALL, steps=20, warmup_steps=5)
    whole = Trainer(data, settings, TrainedOn())
    whole.run(tmp_path / "whole.pt")
    stopped = Trainer(data, settings, TrainedOn())
    for _ in range(7):
        stopped.take_step()
    stopped.save_checkpoint(tmp_path / "stopped.pt")
    resumed = Trainer(data, settings, TrainedOn())
    resumed.run(tmp_path / "stopped.pt")
    assert resumed.losses == whole.losses
    for name, tensor in whole.average.state_dict().items():
        assert torch.equal(resumed.average.state_dict()[name], tensor)
    other = Trainer(data, replace(settings, evenness=0.5), TrainedOn())
    with pytest.raises(ValueError, match=r"found a run with evenness 0\.75, expected 0\.5"):
        other.resume(tmp_path / "whole.pt")


def test_weights_go_out_and_come_back(tmp_path: Path) -> None:
    torch.manual_seed(4)
    network = shaken(GuidedNewtonNetwork(iterations=(3, 0, 9), widths=(5, 6), most_passes=8, tolerance=0.25))
    trained = TrainedOn(stiffness_range=(0.5, 150.0))
    network.to_weights(trained, {"seed": 4}).save(tmp_path / "weights.npz")
    weights = EmulatorWeights.load(tmp_path / "weights.npz")
    assert (weights.trained_on, weights.manifest) == (trained, {"seed": 4})
    assert weights.newton == NewtonSchedule((3, 0, 9), 8, 0.25)
    back = GuidedNewtonNetwork.from_weights(weights)
    assert back.schedule == network.schedule
    assert set(back.state_dict()) == set(network.state_dict()) == set(weights.parameters)
    for name, tensor in network.state_dict().items():
        assert torch.equal(back.state_dict()[name], tensor)
    shapes = {name: array.shape for name, array in weights.parameters.items()}
    assert shapes["start.0.weight"] == (5, guide_inputs(START_SIZE))
    assert shapes["passes.2.2.weight"] == (PASS_SIZE[0], 6)
    with pytest.raises(ValueError, match="found a patch network, expected one that guides Newton steps"):
        GuidedNewtonNetwork.from_weights(PatchNetwork().to_weights())
    with pytest.raises(ValueError, match=r"found a network that guides Newton steps \(guided-newton\), expected patch"):
        PatchNetwork.from_weights(weights)
    uneven = {name: array for name, array in weights.parameters.items() if name.startswith("start")}
    uneven |= GuidedNewtonNetwork(iterations=(3,), widths=(5, 7)).to_weights().parameters | uneven
    with pytest.raises(ValueError, match="found guides of different widths"):
        GuidedNewtonNetwork.from_weights(EmulatorWeights(uneven, newton=NewtonSchedule((3,))))


def config(path: Path, **changes: object) -> Path:
    values = {**SMALL, "warmup_steps": 5, **changes}
    lines = []
    for key, value in values.items():
        shown = f'"{value}"' if isinstance(value, str) else list(value) if isinstance(value, tuple) else value
        lines.append(f"{key} = {shown}")
    path.write_text("\n".join(lines))
    return path


def test_the_command_trains_on_several_folders(
    folders: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings, output = config(tmp_path / "small.toml"), tmp_path / "weights.npz"
    command = ["train", *map(str, folders), "--config", str(settings), "-o", str(output), "--steps", "12", "--quiet"]
    command += ["--device", "cpu", "--validation", str(folders[0])]
    assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "after 12 steps" in said and "on 3 sequences (177 frames" in said and "validation: single frame" in said
    assert output.with_suffix(".png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    weights = EmulatorWeights.load(output)
    assert weights.newton == NewtonSchedule((2, 3), 2, 0.0)
    assert weights.manifest["settings"]["architecture"] == "guided-newton"
    assert cli.main(command) == 0  # nothing is left to do
    assert "continuing after step 12" in capsys.readouterr().err
    config(settings, widths=(12, 9))
    assert cli.main(command) == 2
    assert "found a run with widths [12, 8], expected [12, 9]" in capsys.readouterr().err


def test_settings_that_do_not_fit_are_refused(
    folders: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for changes, message in (
        ({"architecture": "newton"}, "architecture: found 'newton', expected guided-newton or patch"),
        ({"noise": 0.1}, "found unknown noise"),
        ({"widths": ()}, "widths: found []"),
        ({"widths": (8, 0)}, "widths: found [8, 0]"),
        ({"widths": 8}, "widths: found 8"),
        ({"iterations": (3, -1)}, "iterations: found -1"),
        ({"iterations": (3, 1.5)}, "iterations: found 1.5"),
        ({"most_passes": -1}, "most_passes: found -1"),
        ({"tolerance": -0.5}, "tolerance: found -0.5"),
        ({"tolerance": "small"}, "tolerance: found 'small'"),
        ({"repeats": -1}, "repeats: found -1, expected 0 to 100"),
        ({"evenness": 1.5}, "evenness: found 1.5, expected 0 to 1"),
        ({"evenness": math.nan}, "evenness: found nan"),
        ({"learning_rate": math.inf}, "learning_rate: found inf"),
        ({"frames_a_step": 0}, "frames_a_step: found 0"),
    ):
        path = config(tmp_path / "changed.toml", **changes)
        assert cli.main(["train", str(folders[0]), "--config", str(path), "-o", str(tmp_path / "w.npz")]) == 2
        said = capsys.readouterr().err
        assert message in said and str(path) in said
    (tmp_path / "empty").mkdir()
    missing = ["train", str(folders[0]), str(tmp_path / "empty"), "-o", str(tmp_path / "w.npz")]
    assert cli.main(missing) == 2
    assert "found no sequences" in capsys.readouterr().err
    assert not (tmp_path / "w.npz").exists()
