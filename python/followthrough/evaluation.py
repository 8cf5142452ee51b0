# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a solver is from a sequence's true motion, measured as [DE] does (Table 2)."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable
from collections.abc import Sequence as SequenceOf
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray
from followthrough.elastic import ElasticBody
from followthrough.sequences import Sequence
from followthrough.solver import Solver


@dataclass(frozen=True)
class EnergyStatistics:
    """Elastic energy over the frames, J."""

    min: float
    stdev: float
    max: float


@dataclass(frozen=True)
class Scores:
    """Root mean square errors over all predicted frames, vertices (constrained ones included) and axes, m; and costs.

    Attributes
    ----------
    single_frame
        Every frame predicted from true history.
    rollout_24, rollout_48, rollout_all
        Frames predicted from the first one on: the first 24, the first 48, all. Infinite where the motion explodes.
    predicted, truth
        Elastic energy of the rollout and of the true motion.
    ms_per_frame
        Milliseconds a frame of the rollout.
    frames, vertices, free_vertices
        Predicted frames, and counts of vertices.
    """

    single_frame: float
    rollout_24: float
    rollout_48: float
    rollout_all: float
    predicted: EnergyStatistics
    truth: EnergyStatistics
    ms_per_frame: float
    frames: int
    vertices: int
    free_vertices: int


def evaluate(
    sequence: Sequence,
    solver: Solver,
    frames: Callable[[range], Iterable[int]] = lambda frames: frames,
) -> Scores:
    """Score a solver against a sequence's dynamic positions.

    Parameters
    ----------
    sequence
        With `dynamic`, and two frames at least.
    solver
        Made for this sequence's vertices and dt.
    frames
        Wraps the range of frames, for example into a progress bar.

    Raises
    ------
    ValueError
        Where the sequence has no true motion, or only one frame.
    """
    truth, reference = sequence.dynamic, sequence.reference
    if truth is None:
        raise ValueError("dynamic: found none, expected the true motion (followthrough simulate fills it in)")
    if sequence.frame_count < 2:
        raise ValueError("dynamic: found one frame, expected at least two")
    rollout = np.full_like(truth, np.inf)
    rollout[0] = truth[0]
    single = np.zeros(sequence.frame_count)
    seconds = 0.0
    solver.resume(truth[:1], reference[:1])
    exploded = False
    for frame in frames(range(1, sequence.frame_count)):
        ahead = reference[frame + 1] if frame + 1 < sequence.frame_count else None
        if not exploded:
            start = time.perf_counter()
            rollout[frame] = solver.step(reference[frame], ahead)
            seconds += time.perf_counter() - start
            exploded = not np.isfinite(rollout[frame]).all()
        state = solver.state()
        solver.resume(truth[:frame], reference[:frame])
        single[frame] = mean_square(solver.step(reference[frame], ahead), truth[frame])
        if not exploded:
            solver.restore(state)
    errors = np.array([mean_square(now, true) for now, true in zip(rollout[1:], truth[1:], strict=True)])
    free = int(np.count_nonzero(~sequence.constrained))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # inverted rest tets: the solver has said so
        body = ElasticBody.of_sequence(sequence)
    return Scores(
        single_frame=root_mean(single[1:]),
        rollout_24=root_mean(errors[:24]),
        rollout_48=root_mean(errors[:48]),
        rollout_all=root_mean(errors),
        predicted=_energies(body, rollout[1:]),
        truth=_energies(body, truth[1:]),
        ms_per_frame=1000 * seconds / max(int(np.isfinite(errors).sum()), 1),
        frames=sequence.frame_count - 1,
        vertices=sequence.vertex_count,
        free_vertices=free,
    )


def mean_square(positions: FloatArray, true: FloatArray) -> float:
    """Mean square error over vertices and axes; infinite where a position is not finite."""
    if not np.isfinite(positions).all():
        return float("inf")
    with np.errstate(over="ignore"):
        return float(np.mean((positions - true) ** 2))


def root_mean(squares: SequenceOf[float] | NDArray[np.float64]) -> float:
    """Square root of the mean of mean square errors."""
    return float(np.sqrt(np.mean(squares)))


def _energies(body: ElasticBody, motion: FloatArray) -> EnergyStatistics:
    energies = np.array([body.energy(now) if np.isfinite(now).all() else np.inf for now in motion])
    if not np.isfinite(energies).all():
        return EnergyStatistics(float(energies.min()), float("inf"), float("inf"))
    return EnergyStatistics(float(energies.min()), float(energies.std()), float(energies.max()))
