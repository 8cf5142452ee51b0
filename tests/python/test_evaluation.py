# SPDX-License-Identifier: GPL-3.0-or-later
"""Scores against cases whose answer is known."""

import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from followthrough import _core, cli
from followthrough.elastic import CentralDifferences, ElasticBody, ImplicitEuler
from followthrough.evaluation import evaluate
from followthrough.sequences import Sequence
from followthrough.simulation import simulate
from followthrough.springs import Springs

FRAMES = 60


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    rest = np.array(list(itertools.product(range(4), range(2), range(2))), dtype=float) * 0.2
    tets = []
    for x in range(3):
        for tet in ((0, 4, 2, 1), (4, 2, 1, 5), (2, 1, 5, 3), (4, 6, 2, 5), (6, 5, 7, 3), (6, 2, 5, 3)):
            tets.append([4 * x + corner for corner in tet])
    t = np.arange(FRAMES)
    swing = np.stack([0 * t, 0.1 * np.sin(0.7 * t), 0.05 * np.sin(0.3 * t)], axis=1)
    return Sequence(
        rest_positions=rest,
        tets=np.array(tets, dtype=np.int32),
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.full(len(rest), 5e4),
        dt=math.sqrt(0.001),
        reference=rest + swing[:, None],
    )


def implicit(sequence: Sequence) -> ImplicitEuler:
    return ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt)


@pytest.fixture(scope="module")
def truth(sequence: Sequence) -> Sequence:
    return simulate(sequence, implicit(sequence))


def test_the_truth_scores_zero(truth: Sequence) -> None:
    scores = evaluate(truth, implicit(truth))
    assert scores.single_frame == scores.rollout_24 == scores.rollout_48 == scores.rollout_all == 0
    assert scores.predicted == scores.truth
    assert (scores.frames, scores.vertices, scores.free_vertices) == (FRAMES - 1, 16, 12)
    assert scores.ms_per_frame > 0
    assert truth.dynamic is not None
    body = ElasticBody.of_sequence(truth)
    energies = [body.energy(now) for now in truth.dynamic[1:]]
    assert (scores.truth.min, scores.truth.max) == (min(energies), max(energies))
    assert scores.truth.stdev == pytest.approx(np.std(energies))


def test_errors_are_root_means_over_all_vertices_and_axes(sequence: Sequence) -> None:
    class Still:
        """Stays where it is put."""

        def reset(self, reference: np.ndarray) -> None:
            self.x = reference

        def step(self, reference: np.ndarray, next_reference: np.ndarray | None = None) -> np.ndarray:
            return self.x

        def resume(self, dynamic: np.ndarray, reference: np.ndarray) -> None:
            self.x = dynamic[-1]

        def state(self) -> np.ndarray:
            return self.x

        def restore(self, state: np.ndarray) -> None:
            self.x = state

    rest = sequence.rest_positions
    drift = np.arange(FRAMES)[:, None, None] * np.array([0.03, 0.0, 0.0])  # x only: a third of the mean square
    scores = evaluate(replace(sequence, dynamic=rest + drift), Still())
    step = 0.03 / math.sqrt(3)
    assert scores.single_frame == pytest.approx(step)
    for score, count in ((scores.rollout_24, 24), (scores.rollout_48, 48), (scores.rollout_all, FRAMES - 1)):
        assert score == pytest.approx(step * math.sqrt(np.mean(np.arange(1, count + 1) ** 2)))


def test_single_frames_start_from_true_history(truth: Sequence) -> None:
    body = ElasticBody.of_sequence(truth)
    rough = ImplicitEuler(body, truth.constrained, truth.dt, quality="preview")
    springs = Springs(np.full(16, 500.0), np.full(16, 10.0), truth.dt, truth.constrained)
    for solver in (rough, springs, CentralDifferences(body, truth.constrained, truth.dt)):
        scores = evaluate(truth, solver)
        assert 0 < scores.single_frame < scores.rollout_all < 0.2
        expected = simulate(truth, solver).dynamic
        assert expected is not None and truth.dynamic is not None
        assert scores.rollout_all == pytest.approx(math.sqrt(np.mean((expected - truth.dynamic)[1:] ** 2)))


def test_an_explosion_scores_infinity_and_prints_null(
    truth: Sequence, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "truth.npz"
    truth.save(path)
    command = ["evaluate", str(path), "--solver", "central-differences", "--substeps", "1", "--quiet"]
    assert cli.main([*command, "--json"]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["rollout_all"] is None and values["energy"]["predicted"]["max"] is None
    assert values["single_frame"] is not None
    assert cli.main(command) == 0
    assert "inf" in capsys.readouterr().out


def test_json_is_one_object_with_the_promised_keys(
    truth: Sequence, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "truth.npz"
    truth.save(path)
    printed = []
    usual = _core.threads()
    for threads in (1, 2, 4):
        _core.set_threads(threads)
        assert cli.main(["evaluate", str(path), "--solver", "implicit-euler", "--quality", "fine", "--json"]) == 0
        printed.append(json.loads(capsys.readouterr().out))
    _core.set_threads(usual)
    keys = "single_frame rollout_24 rollout_48 rollout_all energy ms_per_frame frames vertices free_vertices".split()
    assert sorted(printed[0]) == sorted(keys)
    for part in ("predicted", "truth"):
        assert sorted(printed[0]["energy"][part]) == ["max", "min", "stdev"]
    for values in printed:
        values.pop("ms_per_frame")
        assert values == printed[0]


def test_a_sequence_without_truth_is_refused(
    sequence: Sequence, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "motion.npz"
    sequence.save(path)
    assert cli.main(["evaluate", str(path), "--json"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and "found no dynamic" in said.err
    with pytest.raises(ValueError, match="at least two"):
        evaluate(
            replace(sequence, reference=sequence.reference[:1], dynamic=sequence.reference[:1]), implicit(sequence)
        )
