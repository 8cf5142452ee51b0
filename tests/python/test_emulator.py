# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator against the network in plain NumPy, its units, its weights files and its commands."""

import itertools
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from followthrough import cli, emulator_weights
from followthrough.controls import RelativeDamping
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.evaluation import evaluate
from followthrough.sequences import Sequence
from followthrough.settings import Settings, default_solver
from followthrough.simulation import simulate

sys.path.insert(0, str(Path(__file__).parent))
from plain_network import PlainNetwork, random_parameters

CUBE = ((0, 4, 2, 1), (4, 2, 1, 5), (2, 1, 5, 3), (4, 6, 2, 5), (6, 5, 7, 3), (6, 2, 5, 3))  # bits of a corner: x y z
FRAMES = 30


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    """A bar of three cubes on its side, swung at one end."""
    rest = np.array(list(itertools.product(range(4), range(2), range(2))), dtype=float) * 0.2
    tets = [[4 * x + corner for corner in tet] for x in range(3) for tet in CUBE]
    t = np.arange(FRAMES)
    swing = np.stack([0 * t, 0.1 * np.sin(0.7 * t), 0.05 * np.sin(0.3 * t)], axis=1)
    return Sequence(
        rest_positions=rest,
        tets=np.array(tets, dtype=np.int32),
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.linspace(5e4, 5e6, len(rest)),
        dt=math.sqrt(0.001),
        reference=rest + swing[:, None],
    )


@pytest.fixture(scope="module")
def weights() -> EmulatorWeights:
    return EmulatorWeights(random_parameters(0))


@pytest.fixture
def weights_file(weights: EmulatorWeights, tmp_path: Path) -> Path:
    path = tmp_path / "weights.npz"
    weights.save(path)
    return path


@pytest.mark.parametrize(
    "architecture",
    [
        {},
        {"sees_reference": False},
        {"biases": False, "inertia": (20, 7), "force": (33, 5), "displacement": (17,)},
        {"rings": 2, "force": (24,) * 3},
        {"rings": 3, "force": (16, 24), "sees_reference": False},
    ],
)
def test_the_network_is_the_one_that_is_defined(sequence: Sequence, architecture: dict) -> None:
    parameters = random_parameters(1, **architecture)
    plain = PlainNetwork(
        parameters, sequence.rest_positions, sequence.tets, sequence.constrained, sequence.youngs_modulus * 1e-6
    )
    short = replace(sequence, reference=sequence.reference[:12])
    expected = plain.rollout(short.reference)
    result = simulate(short, Emulator.of_sequence(short, EmulatorWeights(parameters))).dynamic
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-6)
    assert np.abs(expected - short.reference).max() > 0.01


def test_the_published_architecture_has_the_published_size(weights: EmulatorWeights) -> None:
    assert weights.parameter_count == 237_571
    assert (weights.rings, weights.sees_reference) == (1, True)
    assert weights.trained_on == TrainedOn()


@pytest.mark.parametrize(("size", "slowness", "density"), [(100.0, 1.0, 1000.0), (0.01, 2.0, 50.0), (3.0, 0.5, 8000.0)])
def test_a_scene_in_other_units_moves_alike(
    sequence: Sequence, weights: EmulatorWeights, size: float, slowness: float, density: float
) -> None:
    scaled = replace(
        sequence,
        rest_positions=sequence.rest_positions * size,
        reference=sequence.reference * size,
        dt=sequence.dt * slowness,
        density=density,
        youngs_modulus=sequence.youngs_modulus * (size / slowness) ** 2 * density / 1000,
    )
    emulator = Emulator.of_sequence(scaled, weights)
    np.testing.assert_allclose(emulator.stiffness, Emulator.of_sequence(sequence, weights).stiffness)
    assert emulator.edge_length == pytest.approx(0.2 * size)
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    result = simulate(scaled, emulator).dynamic
    assert expected is not None and result is not None
    np.testing.assert_allclose(result / size, expected, rtol=0, atol=2e-6)


def test_stiffness_outside_the_trained_range_is_said(sequence: Sequence, weights: EmulatorWeights) -> None:
    soft = replace(sequence, youngs_modulus=np.where(sequence.constrained, 10.0, 2.5e4))
    with pytest.warns(UserWarning, match=r"0\.625 to 0\.625, 12 of 12 free vertices outside the 1\.25 to 125"):
        Emulator.of_sequence(soft, weights)
    wide = EmulatorWeights(weights.parameters, TrainedOn(stiffness_range=(0.5, 150)))
    Emulator.of_sequence(soft, wide)
    with pytest.warns(UserWarning, match=r"outside the 0\.5 to 150"):
        Emulator.of_sequence(sequence, wide, edge_length=0.1)
    with pytest.warns(UserWarning, match=r"poisson_ratio: found 0\.3, but the network learned 0\.45"):
        Emulator.of_sequence(replace(sequence, poisson_ratio=0.3), weights)


def test_history_that_is_known_is_where_the_run_continues(sequence: Sequence, weights: EmulatorWeights) -> None:
    emulator = Emulator.of_sequence(sequence, weights)
    truth = simulate(sequence, emulator)
    assert truth.dynamic is not None
    for frame in (1, 2, 3, 10):
        emulator.resume(truth.dynamic[:frame], truth.reference[:frame])
        np.testing.assert_array_equal(emulator.step(truth.reference[frame]), truth.dynamic[frame])
    scores = evaluate(truth, emulator)
    assert scores.single_frame == scores.rollout_all == 0
    other = evaluate(truth, Emulator.of_sequence(sequence, EmulatorWeights(random_parameters(2))))
    assert 0 < other.single_frame < other.rollout_all


def test_weights_that_come_with_the_package_are_the_default(
    sequence: Sequence,
    weights: EmulatorWeights,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    given, output = tmp_path / "motion.npz", tmp_path / "out.npz"
    sequence.save(given)
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "emulator.npz")
    assert default_solver() == Settings().solver == "springs"
    assert cli.main(["rollout", str(given), "--quiet", "-o", str(output)]) == 2
    assert "brings none for the emulator, expected a weights file" in capsys.readouterr().err
    assert not output.exists()
    weights.save(emulator_weights.SHIPPED)
    assert default_solver() == Settings().solver == "emulator"
    assert cli.main(["rollout", str(given), "--quiet", "-o", str(output)]) == 0
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    np.testing.assert_array_equal(Sequence.load(output).dynamic, expected)


def test_corrections_lead_from_the_network_to_the_true_motion(
    sequence: Sequence, weights_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = tmp_path / "motion.npz"
    body = ElasticBody.of_sequence(sequence)
    simulate(sequence, ImplicitEuler(body, sequence.constrained, sequence.dt)).save(given)
    errors = []
    for corrections in (0, 1, 2):
        command = ["evaluate", str(given), "--weights", str(weights_file), "--corrections", str(corrections)]
        assert cli.main([*command, "--quiet", "--json"]) == 0
        scores = json.loads(capsys.readouterr().out)
        errors.append((scores["single_frame"], scores["rollout_all"]))
    assert np.all(np.diff(errors, axis=0) < 0)
    assert errors[1][1] < 0.1 * errors[0][1]
    output = tmp_path / "out.npz"
    assert (
        cli.main(["rollout", str(given), "--weights", str(weights_file), "--corrections", "2", "-o", str(output)]) == 0
    )
    corrected, true = Sequence.load(output).dynamic, Sequence.load(given).dynamic
    assert corrected is not None and true is not None
    assert np.sqrt(np.mean((corrected - true)[1:] ** 2)) == pytest.approx(errors[-1][1])


def test_amplitude_gravity_and_damping_on_the_command_line(
    sequence: Sequence, weights: EmulatorWeights, weights_file: Path, tmp_path: Path
) -> None:
    given, output = tmp_path / "motion.npz", tmp_path / "out.npz"
    sequence.save(given)

    def rollout(*options: str) -> np.ndarray:
        command = ["rollout", str(given), "--weights", str(weights_file), "--quiet", "-o", str(output)]
        assert cli.main([*command, *options]) == 0
        dynamic = Sequence.load(output).dynamic
        assert dynamic is not None
        return dynamic

    reference, usual = sequence.reference, rollout()
    np.testing.assert_array_equal(rollout("--amplitude", "0"), reference)
    np.testing.assert_allclose(rollout("--amplitude", "2") - reference, 2 * (usual - reference), rtol=0, atol=1e-12)
    heavy = Emulator.of_sequence(sequence, weights, gravity=(0, 1, -9.81))
    np.testing.assert_array_equal(rollout("--gravity", "0", "1", "-9.81"), simulate(sequence, heavy).dynamic)
    assert np.abs(simulate(sequence, heavy).dynamic - usual).max() > 1e-3
    damped = RelativeDamping(Emulator.of_sequence(sequence, weights), 4.0, sequence.dt)
    np.testing.assert_array_equal(rollout("--relative-damping", "4"), simulate(sequence, damped).dynamic)
    assert np.abs(simulate(sequence, damped).dynamic - usual).max() > 1e-4


def has_bfloat16(sequence: Sequence, weights: EmulatorWeights) -> bool:
    """Whether this machine has it; where it does not, it must say what it lacks and what to use."""
    try:
        Emulator.of_sequence(sequence, weights, precision="bfloat16")
    except ValueError as error:
        assert "precision: found bfloat16, which needs a processor with AMX" in str(error)
        assert "use float32" in str(error)
        return False
    return True


def test_bfloat16_is_the_same_motion_but_for_rounding_or_is_refused(
    sequence: Sequence, weights: EmulatorWeights, weights_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, output = tmp_path / "motion.npz", tmp_path / "out.npz"
    sequence.save(given)
    command = ["rollout", str(given), "--weights", str(weights_file), "--precision", "bfloat16", "-o", str(output)]
    if not has_bfloat16(sequence, weights):
        assert cli.main(command) == 2
        assert "found bfloat16, which needs" in capsys.readouterr().err
        assert not output.exists()
        return
    exact = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    rounded = simulate(sequence, Emulator.of_sequence(sequence, weights, precision="bfloat16")).dynamic
    motion = np.linalg.norm(exact - sequence.reference)
    assert 1e-6 * motion < np.linalg.norm(rounded - exact) < 0.01 * motion
    assert cli.main(command) == 0
    np.testing.assert_array_equal(Sequence.load(output).dynamic, rounded)


def test_a_precision_that_does_not_fit_is_refused(sequence: Sequence, weights: EmulatorWeights) -> None:
    with pytest.raises(ValueError, match="precision: found 'half', expected 'float32' or 'bfloat16'"):
        Emulator.of_sequence(sequence, weights, precision="half")
    with pytest.raises(ValueError, match="found bfloat16, expected float32 for a network that guides Newton steps"):
        Emulator.of_sequence(sequence, EmulatorWeights.shipped(), precision="bfloat16")


def test_weights_files_keep_everything(weights: EmulatorWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    trained = TrainedOn(edge_length=1.0, dt=0.5, density=2.0, stiffness_range=(0.5, 150.0))
    EmulatorWeights(weights.parameters, trained, {"seed": 3, "data": ["sphere"]}).save(path)
    loaded = EmulatorWeights.load(path)
    assert (loaded.trained_on, loaded.manifest) == (trained, {"seed": 3, "data": ["sphere"]})
    assert set(loaded.parameters) == set(weights.parameters)
    for name, array in weights.parameters.items():
        assert loaded.parameters[name].dtype == np.float32
        np.testing.assert_array_equal(loaded.parameters[name], array)
    bare = tmp_path / "bare.npz"  # without metadata: a network of the paper
    np.savez(bare, **weights.parameters)
    assert EmulatorWeights.load(bare).trained_on == TrainedOn()


def test_weights_files_that_are_not_ours_are_refused(weights: EmulatorWeights, tmp_path: Path) -> None:
    path = tmp_path / "weights.npz"
    good = dict(weights.parameters)

    def refused(changes: dict, message: str, drop: tuple[str, ...] = ()) -> None:
        arrays = {name: array for name, array in {**good, **changes}.items() if name not in drop}
        np.savez(path, **arrays)
        with pytest.raises(ValueError, match=message) as caught:
            EmulatorWeights.load(path)
        assert str(path) in str(caught.value)

    nan = good["edge_mlp.2.weight"].copy()
    nan[3, 5] = np.nan
    refused({"edge_mlp.2.weight": nan}, r"edge_mlp\.2\.weight: found nan at \[3, 5\]")
    refused({}, r"found no point_mlp\.0\.weight", drop=("point_mlp.0.weight",))
    refused({}, r"found edge_mlp\.4\.bias, edge_mlp\.6\.bias, .* without gaps", drop=("edge_mlp.4.weight",))
    refused({"edge_mlp.2.weight": np.zeros((128, 100), np.float32)}, r"expected \(128, 128\), a column an input")
    refused({"edge_mlp.0.weight": np.zeros((128, 36), np.float32)}, r"found shape \(128, 36\), expected \(128, 37\)")
    refused({"point_mlp.0.weight": np.zeros((64, 12), np.float32)}, "found 12 columns, expected 18, or 9")
    refused(
        {"point_mlp.2.bias": np.zeros(63, np.float32)}, r"point_mlp\.2\.bias: found shape \(63,\), expected \(64,\)"
    )
    refused({"point_mlp.2.bias": np.zeros((64, 1), np.float32)}, r"found shape \(64, 1\), expected \(outputs,\)")
    refused({"instance_mlp.8.weight": np.zeros((4, 192), np.float32)}, r"instance_mlp\.8\.bias|found 4 outputs")
    refused({"point_mlp.0.weight": np.zeros((64, 18), np.int32)}, "found int32, expected float32")
    refused({"colour": np.zeros(3, np.float32)}, "found colour, expected only weights and biases")
    refused({"edge_mlp.0.weight": np.full((128, 37), 1e300)}, "found inf")
    refused({"followthrough": np.array("{]")}, "metadata that this version cannot read")
    refused(
        {"followthrough": np.array(json.dumps({"format": 9, "network": "patch", "trained_on": {}, "manifest": {}}))},
        "found format 9",
    )
    refused({"edge_mlp.0.weight": np.array([{}], dtype=object)}, "edge_mlp.0.weight: found Python objects")
    np.savez(path, **good)
    path.write_bytes(path.read_bytes()[:-5000])
    with pytest.raises(ValueError, match=r"no readable \.npz archive"):
        EmulatorWeights.load(path)
    with pytest.raises(ValueError, match="found no such file"):
        EmulatorWeights.load(tmp_path / "missing.npz")


def test_rollout_and_evaluate_on_the_command_line(
    sequence: Sequence, weights: EmulatorWeights, weights_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, output = tmp_path / "motion.npz", tmp_path / "out.npz"
    sequence.save(given)
    expected = simulate(sequence, Emulator.of_sequence(sequence, weights)).dynamic
    assert cli.main(["rollout", str(given), "--weights", str(weights_file), "-o", str(output)]) == 0
    said = capsys.readouterr()
    assert f"{FRAMES} frames of 16 vertices" in said.out
    assert "warning" not in said.err
    np.testing.assert_array_equal(Sequence.load(output).dynamic, expected)

    assert cli.main(["evaluate", str(output), "--weights", str(weights_file), "--json"]) == 0
    scores = json.loads(capsys.readouterr().out)
    assert scores["rollout_all"] == scores["single_frame"] == 0
    assert scores["ms_per_frame"] > 0
    assert (scores["frames"], scores["vertices"], scores["free_vertices"]) == (FRAMES - 1, 16, 12)
    assert cli.main(["evaluate", str(output), "--solver", "springs", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["rollout_all"] > 0

    replace(sequence, youngs_modulus=np.full(16, 1e4)).save(given)
    assert cli.main(["rollout", str(given), "--weights", str(weights_file), "--quiet", "-o", str(output)]) == 0
    assert "outside the 1.25 to 125" in capsys.readouterr().err


def test_commands_with_bad_weights_say_so(
    sequence: Sequence, weights_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given, output = tmp_path / "motion.npz", tmp_path / "out.npz"
    sequence.save(given)
    for arguments, message in (
        (["rollout", given, "--weights", weights_file, "--corrections", -1, "-o", output], "--corrections: found -1"),
        (["rollout", given, "--weights", weights_file, "--amplitude", -1, "-o", output], "amplitude: found -1"),
        (["rollout", given, "--weights", weights_file, "--relative-damping", -1, "-o", output], "rate: found -1"),
        (["simulate", given, "--corrections", 1, "-o", output], "--corrections: found together with --solver springs"),
        (["evaluate", given, "--solver", "emulator"], "found no dynamic"),
        (["rollout", given, "--weights", given, "-o", output], "found rest_positions, expected only weights"),
        (["rollout", given, "--weights", weights_file, "--edge-length", -1, "-o", output], "edge_length: found -1"),
        (["simulate", given, "--solver", "springs", "--weights", weights_file, "-o", output], "only with emulator"),
        (["simulate", given, "--solver", "springs", "--edge-length", 1, "-o", output], "--edge-length: found together"),
        (["simulate", given, "--precision", "bfloat16", "-o", output], "--precision: found together"),
        (["rollout", given, "--weights", weights_file, "-o", tmp_path / "no" / "out.npz"], "is not there"),
    ):
        assert cli.main([str(argument) for argument in arguments]) == 2
        assert message in capsys.readouterr().err
    assert not output.exists()
