# SPDX-License-Identifier: GPL-3.0-or-later
"""Newton passes that small networks guide: what training sees, their weights files, and the commands that take them."""

import json
import math
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from followthrough import cli
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.newton_patches import NewtonPatches
from followthrough.newton_weights import NewtonSchedule
from followthrough.sequences import Sequence
from followthrough.simulation import simulate

sys.path.insert(0, str(Path(__file__).parent))
from elastic_scenes import bar
from plain_network import guided_step, random_newton_parameters, random_parameters

FRAMES = 20
SCHEDULE = NewtonSchedule((4, 8), most_passes=3, tolerance=0.0)


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    """A bar of four cubes on its side, swung and turned at one end."""
    rest, tets = bar(4, 1, 1)
    angle = 0.4 * np.sin(0.4 * np.arange(FRAMES))
    cosine, sine, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 0 * angle + 1
    turn = np.array([[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, one]])
    return Sequence(
        rest_positions=rest,
        tets=tets,
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.linspace(5e4, 2e5, len(rest)),
        dt=math.sqrt(0.001),
        reference=np.einsum("abf,vb->fva", turn, rest),
    )


@pytest.fixture(scope="module")
def weights() -> EmulatorWeights:
    return EmulatorWeights(random_newton_parameters(0, SCHEDULE), newton=SCHEDULE)


@pytest.mark.parametrize("gain", [0.3, 3.0])
def test_guides_on_what_training_sees_are_the_emulator(sequence: Sequence, gain: float) -> None:
    schedule = replace(SCHEDULE, most_passes=2, tolerance=0.0)  # guides make both steps, and no frame ends early
    parameters = random_newton_parameters(0, schedule, gain=gain)
    weights = EmulatorWeights(parameters, newton=schedule)
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    assert expected is not None
    patches = NewtonPatches.of_sequence(sequence)
    free = np.flatnonzero(~sequence.constrained)
    np.testing.assert_array_equal(np.sort(patches.free_vertices), free)
    x, frames, taken_back = sequence.reference, [sequence.reference[0]] * 4, 0

    def take_passes() -> None:
        nonlocal taken_back
        moved = None
        for k, (guide, iterations) in enumerate((("passes.0", 4), ("passes.1", 8))):
            patches.evaluate(iterations)
            taken_back += moved is not None and not np.array_equal(moved, patches.estimate())
            patches.move(guided_step(parameters, guide, *patches.features()), last=k == 1)
            moved = patches.estimate()

    for frame in range(1, FRAMES):
        past = [x[max(frame - k, 0)] for k in range(4)]
        patches.begin(np.array(frames[:-5:-1]), np.array(past))
        patches.move(guided_step(parameters, "start", *patches.start_features()))
        take_passes()
        if patches.end_passes():
            take_passes()
            patches.end_passes()
        frames.append(expected[frame])  # one frame at a time
        np.testing.assert_allclose(patches.estimate(), expected[frame], rtol=0, atol=2e-6 if gain < 1 else 1e-4)
    assert 0.02 < np.abs(expected - x)[:, free].max() < 2
    assert taken_back == 0 if gain < 1 else taken_back > 5  # wild guides are held back


def test_what_training_sees_turns_with_the_scene(sequence: Sequence) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    patches = NewtonPatches.of_sequence(sequence)
    seen = []
    for placed in (np.eye(3), turn):
        x = sequence.reference @ placed.T + (placed[0] * 50)
        patches.begin(np.array([x[6], x[5], x[5], x[4]]), np.array([x[8], x[7], x[6], x[5]]))
        start = patches.start_features()
        patches.evaluate(5)
        seen.append((start, patches.features()))
    for here, there in zip(*seen, strict=True):
        np.testing.assert_allclose(here.vectors @ turn.T, there.vectors, rtol=0, atol=1e-4)
        np.testing.assert_allclose(here.scalars, there.scalars, rtol=0, atol=2e-3)


def test_extra_passes_take_a_frame_to_backward_eulers_answer(sequence: Sequence, weights: EmulatorWeights) -> None:
    truth = simulate(sequence, ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt))
    assert truth.dynamic is not None
    off = []
    for extra in (0, 2, 30):
        result = simulate(
            sequence, Emulator.of_sequence(sequence, weights, extra_passes=extra, extra_iterations=30)
        ).dynamic
        assert result is not None
        off.append(np.abs(result - truth.dynamic).max())
    assert off[0] > off[1] > off[2]
    assert off[2] < 2e-5
    with pytest.raises(ValueError, match="extra_passes: found 1, expected 0 for a network that takes no Newton steps"):
        Emulator.of_sequence(sequence, EmulatorWeights(random_parameters(0)), extra_passes=1)


def test_soft_pins_are_for_networks_that_take_newton_steps(sequence: Sequence, weights: EmulatorWeights) -> None:
    def make(network: EmulatorWeights, pins: object) -> Emulator:
        s = sequence
        return Emulator(
            s.rest_positions, s.tets, s.constrained, s.youngs_modulus, s.density, s.dt, network, pin_stiffness=pins
        )

    assert make(weights, np.zeros(sequence.vertex_count)).vertex_count == sequence.vertex_count
    with pytest.raises(
        ValueError, match=r"pin_stiffness: found some, expected none for a network that takes no Newton"
    ):
        make(EmulatorWeights(random_parameters(0)), np.ones(sequence.vertex_count))
    with pytest.raises(ValueError, match="pin_stiffness: found"):
        make(weights, np.ones(3))
    with pytest.raises(
        ValueError, match=r"pin_stiffness: found -1.0.* at vertex 0, expected finite numbers, 0 or more"
    ):
        make(weights, -np.ones(sequence.vertex_count))


def test_the_material_is_the_scenes_own(sequence: Sequence, weights: EmulatorWeights) -> None:
    with pytest.warns(UserWarning, match=r"poisson_ratio: found 0\.3, but the network learned 0\.45 and guides others"):
        other = Emulator.of_sequence(replace(sequence, poisson_ratio=0.3), weights)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        usual = Emulator.of_sequence(sequence, weights)
    assert np.abs(simulate(sequence, other).dynamic - simulate(sequence, usual).dynamic).max() > 1e-4


def test_weights_files_keep_everything(weights: EmulatorWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    trained = TrainedOn(stiffness_range=(0.1, 900.0))
    schedule = NewtonSchedule((8, 0, 3), most_passes=7, tolerance=0.25)
    parameters = random_newton_parameters(1, schedule, widths=(5,))
    EmulatorWeights(parameters, trained, {"seed": 3}, schedule).save(path)
    loaded = EmulatorWeights.load(path)
    assert (loaded.network, loaded.newton, loaded.trained_on) == ("guided-newton", schedule, trained)
    assert loaded.manifest == {"seed": 3}
    assert set(loaded.parameters) == set(parameters)
    for name, array in parameters.items():
        np.testing.assert_array_equal(loaded.parameters[name], array)
    assert loaded.parameter_count == sum(array.size for array in parameters.values())


def test_a_digest_tells_apart_what_predicts_differently(weights: EmulatorWeights) -> None:
    others = [
        replace(weights, newton=replace(SCHEDULE, tolerance=1e-2)),
        replace(weights, newton=replace(SCHEDULE, most_passes=2)),
        replace(weights, newton=replace(SCHEDULE, iterations=(4, 9))),
        replace(weights, trained_on=TrainedOn(poisson_ratio=0.4)),
        replace(weights, parameters=random_newton_parameters(1, SCHEDULE)),
    ]
    assert len({weights.digest(), *(other.digest() for other in others)}) == 6
    assert replace(weights, manifest={"seed": 5}).digest() == weights.digest()


def test_weights_that_do_not_fit_are_refused(weights: EmulatorWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    good = dict(weights.parameters)
    weights.save(path)
    with np.load(path) as file:
        metadata = json.loads(str(file["followthrough"]))

    def refused(message: str, changes: dict | None = None, drop: str = "", **said: object) -> None:
        arrays = {name: array for name, array in {**good, **(changes or {})}.items() if name != drop}
        np.savez(path, **arrays, followthrough=np.array(json.dumps(metadata | said)))
        with pytest.raises(ValueError, match=message) as caught:
            EmulatorWeights.load(path)
        assert str(path) in str(caught.value)

    nan = good["passes.0.1.weight"].copy()
    nan[3, 5] = np.nan
    refused(r"passes\.0\.1\.weight: found nan at \[3, 5\]", {"passes.0.1.weight": nan})
    refused(r"found no passes\.0\.0\.weight, expected at least one layer", drop="passes.0.0.weight")
    refused(r"found no start\.0\.bias, expected one of shape \(12,\)", drop="start.0.bias")
    refused(
        r"start\.0\.weight: found shape \(12, 48\), expected \(12, 49\)",
        {"start.0.weight": np.zeros((12, 48), np.float32)},
    )
    refused(r"passes\.1\.2\.weight: found shape \(5, 8\)", {"passes.1.2.weight": np.zeros((5, 8), np.float32)})
    refused(
        r"found passes\.0\.4\.weight, expected only parameters", {"passes.0.4.weight": np.zeros((2, 2), np.float32)}
    )
    refused(r"found passes\.2\.0\.bias, expected only parameters", {"passes.2.0.bias": np.zeros(1, np.float32)})
    refused(r"found point_mlp\.0\.weight, expected only", {"point_mlp.0.weight": np.zeros((64, 18), np.float32)})
    refused("found int64, expected float32", {"start.0.bias": np.zeros(12, np.int64)})
    refused("found inf", {"start.0.bias": np.full(12, 1e300)})
    for iterations, message in (
        ([-1, 8], "iterations: found -1"),
        ([2.5, 8], r"iterations: found 2\.5"),
        ([4, 10**9], "iterations: found 1000000000, expected a whole number, 0 to 10000"),
        ([4], "expected only parameters of the passes"),
        (None, "metadata that this version cannot read"),
    ):
        refused(message, iterations=iterations)
    refused("most_passes: found -2", most_passes=-2)
    refused("tolerance: found nan", tolerance=math.nan)
    refused("found format 1 of a network called patch-oldton", network="patch-oldton")
    refused("expected only", network="patch")
    weights.save(path)
    path.write_bytes(path.read_bytes()[:-700])
    with pytest.raises(ValueError, match=r"no readable \.npz archive"):
        EmulatorWeights.load(path)


def test_rollout_and_evaluate_on_the_command_line(
    sequence: Sequence, weights: EmulatorWeights, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, output, file = tmp_path / "motion.npz", tmp_path / "out.npz", tmp_path / "weights.npz"
    sequence.save(given)
    weights.save(file)
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    assert cli.main(["rollout", str(given), "--weights", str(file), "-o", str(output)]) == 0
    said = capsys.readouterr()
    assert f"{FRAMES} frames of 20 vertices" in said.out
    assert "warning" not in said.err
    np.testing.assert_array_equal(Sequence.load(output).dynamic, expected)
    assert cli.main(["evaluate", str(output), "--weights", str(file), "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["rollout_all"] == scores["single_frame"] == 0
    assert (scores["frames"], scores["vertices"], scores["free_vertices"]) == (FRAMES - 1, 20, 16)


def test_frames_that_do_not_fit_are_refused(sequence: Sequence) -> None:
    patches = NewtonPatches.of_sequence(sequence)
    frames = sequence.reference[:4]
    with pytest.raises(ValueError, match="estimate: found none, expected begin"):
        patches.evaluate(3)
    with pytest.raises(ValueError, match="estimate: found none, expected begin"):
        patches.start_features()
    with pytest.raises(ValueError, match=r"dynamic: found shape \(2, 20, 3\), expected \(4, 20, 3\)"):
        patches.begin(frames[:2], frames)
    broken = frames.copy()
    broken[1, 3, 2] = np.inf
    with pytest.raises(ValueError, match=r"reference\[1\]: "):
        patches.begin(frames, broken)
    patches.begin(frames, frames)
    with pytest.raises(ValueError, match="estimate: found none that was evaluated"):
        patches.features()
    with pytest.raises(ValueError, match="estimate: found none that was evaluated"):
        patches.end_passes()
    patches.evaluate(2)
    with pytest.raises(ValueError, match=r"step: found shape \(3, 3\), expected \(16, 3\)"):
        patches.move(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="step: found NaN"):
        patches.move(np.full((16, 3), np.nan))
