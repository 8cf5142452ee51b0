# SPDX-License-Identifier: GPL-3.0-or-later
"""Amplitude, damping and pins around any solver, as Python sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from elastic_scenes import bar

from followthrough.controls import Amplified, RelativeDamping, SoftPins
from followthrough.elastic import ElasticBody, ImplicitEuler, PredictorCorrector
from followthrough.evaluation import evaluate
from followthrough.quasistatic import OverQuasistatic, Quasistatic
from followthrough.sequences import Sequence
from followthrough.simulation import simulate, uniform_constants
from followthrough.solver import Solver
from followthrough.springs import Springs


@pytest.fixture(scope="module")
def sequence() -> Sequence:
    rest, tets = bar(4, 2, 2)
    t = np.arange(16)
    swing = np.stack([0 * t, 0.15 * np.sin(0.9 * t), 0.1 * np.sin(0.5 * t)], axis=1)
    return Sequence(
        rest_positions=rest,
        tets=tets,
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.full(len(rest), 5e4),
        dt=1 / 24,
        reference=rest + swing[:, None],
    )


def flesh(sequence: Sequence) -> ImplicitEuler:
    return ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt)


def springs(sequence: Sequence) -> Springs:
    return Springs(*uniform_constants(sequence.vertex_count), sequence.dt, sequence.constrained)


def over_quasistatic(sequence: Sequence) -> Solver:
    layer = Quasistatic(ElasticBody.of_sequence(sequence), sequence.constrained, gravity=(0, 0, -5))
    return OverQuasistatic(layer, springs(sequence))


@pytest.mark.parametrize("make", [flesh, springs, over_quasistatic])
def test_an_amplitude_is_linear_from_the_first_frame_on(sequence: Sequence, make: Callable[[Sequence], Solver]) -> None:
    plain = simulate(sequence, make(sequence)).dynamic
    assert plain is not None
    np.testing.assert_array_equal(simulate(sequence, Amplified(make(sequence), 0.0)).dynamic, sequence.reference)
    for amplitude in (0.3, 2.0):
        result = simulate(sequence, Amplified(make(sequence), amplitude)).dynamic
        assert result is not None
        expected = sequence.reference + amplitude * (plain - sequence.reference)
        np.testing.assert_allclose(result, expected, rtol=0, atol=1e-12)


def controlled(sequence: Sequence) -> dict[str, Callable[[], Solver]]:
    share = np.linspace(0.5, 1.0, sequence.vertex_count)
    return {
        "amplified": lambda: Amplified(springs(sequence), 1.0),
        "damped": lambda: RelativeDamping(flesh(sequence), 3.0, sequence.dt),
        "pinned": lambda: SoftPins(flesh(sequence), share),
        "corrected": lambda: PredictorCorrector(flesh(sequence), flesh(sequence)),
        "all": lambda: RelativeDamping(
            PredictorCorrector(SoftPins(flesh(sequence), share), flesh(sequence)), 3.0, sequence.dt
        ),
    }


@pytest.mark.parametrize("name", ["amplified", "damped", "pinned", "corrected", "all"])
def test_a_state_and_a_known_history_continue_the_run(sequence: Sequence, name: str) -> None:
    make = controlled(sequence)[name]
    truth = simulate(sequence, make())
    assert truth.dynamic is not None
    solver, other = make(), make()
    solver.reset(sequence.reference[0])
    for frame in range(1, 8):
        solver.step(sequence.reference[frame], sequence.reference[frame + 1])
    other.restore(solver.state())
    for frame in range(8, 12):
        ahead = sequence.reference[frame + 1]
        np.testing.assert_array_equal(other.step(sequence.reference[frame], ahead), truth.dynamic[frame])
    # The damped past is not the one that was seen, but it follows from that.
    if name != "amplified":  # springs know velocities better than frames do
        assert evaluate(truth, make()).single_frame < 1e-9


def test_relative_damping_does_not_hold_back_what_moves_as_one_with_its_reference(sequence: Sequence) -> None:
    still = replace(sequence, reference=sequence.rest_positions + 3.0 * np.arange(16)[:, None, None] * sequence.dt)
    solver = RelativeDamping(flesh(sequence), 30.0, sequence.dt)
    solver.resume(still.reference[:2], still.reference[:2])
    for frame in range(2, 16):
        np.testing.assert_allclose(solver.step(still.reference[frame]), still.reference[frame], rtol=0, atol=1e-9)


def test_damping_of_the_relative_motion_lets_swinging_die_down(sequence: Sequence) -> None:
    rest = sequence.rest_positions

    def left(rate: float) -> float:
        solver = RelativeDamping(flesh(sequence), rate, sequence.dt)
        solver.resume(sequence.reference[:8], sequence.reference[:8])
        return max(np.abs(solver.step(rest) - rest).max() for _ in range(12))

    sizes = [left(rate) for rate in (0.0, 5.0, 50.0)]
    assert sizes == sorted(sizes, reverse=True) and sizes[-1] < 0.9 * sizes[0]


def test_solvers_that_carry_velocities_are_refused(sequence: Sequence) -> None:
    for make in (
        lambda: RelativeDamping(springs(sequence), 1.0, sequence.dt),
        lambda: SoftPins(springs(sequence), np.ones(sequence.vertex_count)),
        lambda: PredictorCorrector(springs(sequence), flesh(sequence)),
    ):
        with pytest.raises(ValueError, match="whose state is not its last frames, expected one such as Emulator"):
            make()
