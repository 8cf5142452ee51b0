# SPDX-License-Identifier: GPL-3.0-or-later
"""The truth of a data set: converged steps only."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.sequences import Sequence

#: A step counts as true where its residual is no larger than this, relative to its inertial and its elastic part.
ACCEPTED_RESIDUAL = 1e-8
#: Newton iterations, and iterations of conjugate gradients within one: as "converged" has them, and of a step that is tried again.
_FIRST_TRY: tuple[int | None, int | None] = (None, None)
_PATIENCE = (300, 5000)


@dataclass(frozen=True, eq=False)
class Truth:
    """A simulated sequence, and how it went.

    Attributes
    ----------
    sequence : Sequence
        With `dynamic`; cut before the first step that did not converge.
    worst_residual : float
        Of its steps.
    tried_again : tuple of int
        Frames that converged only with more iterations.
    stopped_at : int or None
        The frame that did not converge with those either.
    stopped_residual : float or None
        What its residual was.
    """

    sequence: Sequence
    worst_residual: float
    tried_again: tuple[int, ...]
    stopped_at: int | None = None
    stopped_residual: float | None = None


def simulate_truth(sequence: Sequence, frame_done: Callable[[], None] = lambda: None) -> Truth:
    """Simulate a sequence by backward Euler, converged.

    A step that does not converge is tried again with many more iterations; where that fails, the sequence ends before it:
    what is returned is true throughout.

    Parameters
    ----------
    sequence
        The motion. Its first frame is where the simulation starts, at rest.
    frame_done
        Called after every frame, the first one included; may raise to give up.
    """
    solver = _solver(sequence, *_FIRST_TRY)
    patient: ImplicitEuler | None = None
    reference = sequence.reference
    dynamic = np.empty_like(reference)
    dynamic[0] = reference[0]
    solver.reset(reference[0])
    frame_done()
    worst = 0.0
    tried_again: list[int] = []
    for frame in range(1, sequence.frame_count):
        before = solver.state()
        dynamic[frame] = solver.step(reference[frame])
        report = solver.last_step
        if not (report.converged and report.residual <= ACCEPTED_RESIDUAL):
            patient = patient or _solver(sequence, *_PATIENCE)
            patient.restore(before)
            dynamic[frame] = patient.step(reference[frame])
            report = patient.last_step
            if not report.residual <= ACCEPTED_RESIDUAL:
                cut = replace(sequence, reference=reference[:frame], dynamic=dynamic[:frame])
                return Truth(cut, worst, tuple(tried_again), frame, report.residual)
            solver.restore(patient.state())
            tried_again.append(frame)
        worst = max(worst, report.residual)
        frame_done()
    return Truth(replace(sequence, dynamic=dynamic), worst, tuple(tried_again))


def _solver(sequence: Sequence, most_iterations: int | None, most_linear_iterations: int | None) -> ImplicitEuler:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # tets that are inverted at rest are a recipe's own
        body = ElasticBody.of_sequence(sequence)
    return ImplicitEuler(
        body,
        sequence.constrained,
        sequence.dt,
        most_iterations=most_iterations,
        most_linear_iterations=most_linear_iterations,
    )
