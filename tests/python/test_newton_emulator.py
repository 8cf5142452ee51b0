# SPDX-License-Identifier: GPL-3.0-or-later
"""Newton passes that a network corrects: what training sees, their weights files, and the commands that take them."""

import itertools
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
from followthrough.newton_weights import NewtonPass, NewtonSchedule
from followthrough.sequences import Sequence
from followthrough.simulation import simulate

sys.path.insert(0, str(Path(__file__).parent))
from plain_network import random_newton_parameters, random_parameters

CUBE = ((0, 4, 2, 1), (4, 2, 1, 5), (2, 1, 5, 3), (4, 6, 2, 5), (6, 5, 7, 3), (6, 2, 5, 3))  # bits of a corner: x y z
FRAMES = 20
SCHEDULE = NewtonSchedule((NewtonPass(4, "gwsar"), NewtonPass(8)))


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    """A bar of four cubes on its side, swung and turned at one end."""
    rest = np.array(list(itertools.product(range(5), range(2), range(2))), dtype=float) * 0.2
    tets = [[4 * x + corner for corner in tet] for x in range(4) for tet in CUBE]
    angle = 0.4 * np.sin(0.4 * np.arange(FRAMES))
    cosine, sine, zero, one = np.cos(angle), np.sin(angle), 0 * angle, 0 * angle + 1
    turn = np.array([[cosine, -sine, zero], [sine, cosine, zero], [zero, zero, one]])
    return Sequence(
        rest_positions=rest,
        tets=np.array(tets, dtype=np.int32),
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.linspace(5e4, 2e5, len(rest)),
        dt=math.sqrt(0.001),
        reference=np.einsum("abf,vb->fva", turn, rest),
    )


@pytest.fixture(scope="module")
def weights() -> EmulatorWeights:
    return EmulatorWeights(random_newton_parameters(0, {0: "gwsar"}), newton=SCHEDULE)


def network_step(parameters: dict, patches: NewtonPatches, channels: str) -> np.ndarray:
    """A pass's step in NumPy, from what training sees."""
    edges, centres, sigma, rotations = patches.features(channels)
    starts = patches.edge_starts
    centre_of_edge = np.repeat(np.arange(len(sigma)), np.diff(starts))
    share = centres @ parameters["passes.0.centre.weight"].T + parameters["passes.0.centre.bias"]
    h = np.tanh(edges @ parameters["passes.0.edge.0.weight"].T + share[centre_of_edge])
    h = np.tanh(h @ parameters["passes.0.edge.1.weight"].T + parameters["passes.0.edge.1.bias"])
    h = np.concatenate([np.add.reduceat(h, starts[:-1]) / 8, centres], axis=1)
    h = np.tanh(h @ parameters["passes.0.instance.0.weight"].T + parameters["passes.0.instance.0.bias"])
    out = h @ parameters["passes.0.out.weight"].T + parameters["passes.0.skip"] * centres[:, :3]
    return sigma[:, None] * np.einsum("iab,ib->ia", rotations, out)


def test_a_network_on_what_training_sees_is_the_emulator(sequence: Sequence, weights: EmulatorWeights) -> None:
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    assert expected is not None
    patches = NewtonPatches.of_sequence(sequence)
    free = np.flatnonzero(~sequence.constrained)
    np.testing.assert_array_equal(np.sort(patches.free_vertices), free)
    x, frames = sequence.reference, [sequence.reference[0]] * 3
    for frame in range(1, FRAMES):
        patches.begin(np.array(frames[:-4:-1]), np.array([x[max(frame - 2, 0)], x[frame - 1], x[frame]]), SCHEDULE.beta)
        patches.evaluate(4)
        patches.move(network_step(dict(weights.parameters), patches, "gwsar"))
        patches.evaluate(8)
        patches.move(patches.direction())
        frames.append(expected[frame])  # one frame at a time
        np.testing.assert_allclose(patches.estimate(), expected[frame], rtol=0, atol=2e-6)
    assert np.abs(expected - x)[:, free].max() > 0.02


def test_what_training_sees_does_not_turn_with_the_scene(sequence: Sequence) -> None:
    turn, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    patches = NewtonPatches.of_sequence(sequence)
    seen = []
    for placed in (np.eye(3), turn):
        x = sequence.reference @ placed.T + (placed[0] * 50)
        patches.begin(np.array([x[6], x[5], x[5]]), np.array([x[6], x[7], x[8]]))
        patches.evaluate(5)
        seen.append((patches.features("gplwsar"), patches.direction()))
    (here, direction), (there, turned) = seen
    for a, b in zip(here[:3], there[:3], strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=2e-3)
    np.testing.assert_allclose(turn @ here.rotations, there.rotations, rtol=0, atol=1e-5)
    np.testing.assert_allclose(direction @ turn.T, turned, rtol=0, atol=1e-4)


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
    with pytest.raises(ValueError, match="extra_passes: found 1, expected 0 for a network that corrects no passes"):
        Emulator.of_sequence(sequence, EmulatorWeights(random_parameters(0)), extra_passes=1)


def test_the_material_is_the_scenes_own(sequence: Sequence, weights: EmulatorWeights) -> None:
    with pytest.warns(
        UserWarning, match=r"poisson_ratio: found 0\.3, but the network learned 0\.45 and corrects others"
    ):
        other = Emulator.of_sequence(replace(sequence, poisson_ratio=0.3), weights)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        usual = Emulator.of_sequence(sequence, weights)
    assert np.abs(simulate(sequence, other).dynamic - simulate(sequence, usual).dynamic).max() > 1e-4


def test_weights_files_keep_everything(weights: EmulatorWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    trained = TrainedOn(stiffness_range=(0.1, 900.0))
    schedule = NewtonSchedule((NewtonPass(8), NewtonPass(0, "pl"), NewtonPass(3, "g")), beta=0.25)
    parameters = random_newton_parameters(1, {1: "pl", 2: "g"}, edge=(5,), instance=(7, 3))
    EmulatorWeights(parameters, trained, {"seed": 3}, schedule).save(path)
    loaded = EmulatorWeights.load(path)
    assert (loaded.network, loaded.newton, loaded.trained_on) == ("patch-newton", schedule, trained)
    assert loaded.manifest == {"seed": 3}
    assert set(loaded.parameters) == set(parameters)
    for name, array in parameters.items():
        np.testing.assert_array_equal(loaded.parameters[name], array)
    assert loaded.parameter_count == sum(array.size for array in parameters.values())


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

    nan = good["passes.0.edge.1.weight"].copy()
    nan[3, 5] = np.nan
    refused(r"passes\.0\.edge\.1\.weight: found nan at \[3, 5\]", {"passes.0.edge.1.weight": nan})
    refused(r"found no passes\.0\.edge\.0\.weight", drop="passes.0.edge.0.weight")
    refused(r"found no passes\.0\.centre\.bias, expected one of shape \(12,\)", drop="passes.0.centre.bias")
    refused(r"found no passes\.0\.skip, expected one of shape \(1,\)", drop="passes.0.skip")
    refused(r"skip: found shape \(2,\), expected \(1,\)", {"passes.0.skip": np.zeros(2, np.float32)})
    refused(r"skip: found shape \(\), expected \(1,\)", {"passes.0.skip": np.float32(1)})
    wide = np.zeros((12, 24), np.float32)
    refused(r"edge\.0\.weight: found shape \(12, 24\), expected \(12, 23\)", {"passes.0.edge.0.weight": wide})
    refused(r"out\.weight: found shape \(2, 16\)", {"passes.0.out.weight": np.zeros((2, 16), np.float32)})
    refused(r"found passes\.0\.edge\.0\.bias, expected only", {"passes.0.edge.0.bias": np.zeros(12, np.float32)})
    refused(r"found passes\.1\.skip, expected only parameters", {"passes.1.skip": np.zeros(1, np.float32)})
    refused(r"found passes\.0\.edge\.3\.weight", {"passes.0.edge.3.weight": np.zeros((2, 2), np.float32)})
    refused(r"found point_mlp\.0\.weight, expected only", {"point_mlp.0.weight": np.zeros((64, 18), np.float32)})
    refused("found int64, expected float32", {"passes.0.skip": np.zeros(1, np.int64)})
    refused("found inf", {"passes.0.skip": np.full(1, 1e300)})
    for passes, message in (
        ([{"iterations": -1, "channels": "gwsar"}], "iterations: found -1"),
        ([{"iterations": 2.5, "channels": "gwsar"}], r"iterations: found 2\.5"),
        ([{"iterations": 10**9, "channels": "gwsar"}], "expected at most 10000"),
        ([{"iterations": 4, "channels": "gwsaz"}], "channels: found 'gwsaz'"),
        ([{"iterations": 4, "channels": "gwsaa"}], "channels: found 'gwsaa'"),
        ([{"iterations": 4, "channels": ""}], "channels: found ''"),
        ([{"iterations": 4}], "metadata that this version cannot read"),
        ([], "passes: found none"),
        (None, "metadata that this version cannot read"),
        ([{"iterations": 4, "channels": "gws"}], r"expected \(12, 17\)"),
    ):
        refused(message, passes=passes)
    refused(r"beta: found 1\.5", beta=1.5)
    refused("beta: found nan", beta=math.nan)
    refused("found format 1 of a network called patch-oldton", network="patch-oldton")
    refused("found passes.0", network="patch")
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
    frames = sequence.reference[:3]
    with pytest.raises(ValueError, match="estimate: found none, expected begin"):
        patches.evaluate(3)
    with pytest.raises(ValueError, match=r"dynamic: found shape \(2, 20, 3\), expected \(3, 20, 3\)"):
        patches.begin(frames[:2], frames)
    broken = frames.copy()
    broken[1, 3, 2] = np.inf
    with pytest.raises(ValueError, match="reference_now: "):
        patches.begin(frames, broken)
    with pytest.raises(ValueError, match=r"beta: found 1\.5"):
        patches.begin(frames, frames, 1.5)
    patches.begin(frames, frames)
    patches.evaluate(2)
    with pytest.raises(ValueError, match="channels: found gg, expected some of the letters"):
        patches.features("gg")
    with pytest.raises(ValueError, match=r"step: found shape \(3, 3\), expected \(16, 3\)"):
        patches.move(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="step: found NaN"):
        patches.move(np.full((16, 3), np.nan))
