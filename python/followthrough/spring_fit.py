# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs that learn: the constants of every vertex from a few seconds of simulated motion ([ZS] sections 6 and 7)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough import _core, array_checks
from followthrough.character import FloatArray, IntArray
from followthrough.npz_files import write_npz

#: ks (1/s²) and kd (1/s) of a vertex whose motion says nothing about them.
USUAL_STIFFNESS, USUAL_DAMPING = (float(value) for value in _core.USUAL_SPRING)
#: Vertices that are fitted in one call, so that progress is seen and an interrupt heard.
_BLOCK = 512
#: Stiffness over the frame rate squared from which an overdamped spring counts as stiff: it comes to rest within about a frame.
_STIFF = 0.5


class FitStatus(IntEnum):
    """What is known about a vertex's constants."""

    FITTED = 0
    #: Its reference never accelerates: its constants are the usual ones.
    UNMOVED = 1
    #: It never leaves its reference: as stiff as can be told apart, critically damped.
    RIGID = 2
    #: It was left out: its constants are the usual ones.
    SKIPPED = 3


@dataclass(frozen=True)
class Training:
    """A simulated motion to learn from.

    Parameters
    ----------
    reference : (F, n, 3) float
        What the springs hang on, m: skinned positions, or equilibria. They start on its first frame and move with it.
    dynamic : (F, n, 3) float
        Where the simulation put the vertices, m.
    dt
        Seconds a frame.
    """

    reference: FloatArray
    dynamic: FloatArray
    dt: float

    def __post_init__(self) -> None:
        for name in ("reference", "dynamic"):
            frames = array_checks.numbers(name, getattr(self, name))
            if frames.ndim != 3 or frames.shape[2] != 3:
                raise ValueError(f"{name}: found shape {frames.shape}, expected (frames, n, 3)")
            object.__setattr__(self, name, np.ascontiguousarray(frames))


@dataclass(frozen=True)
class FitSettings:
    """How constants are found.

    Parameters
    ----------
    regularization
        How strongly motion that springs cannot describe holds them back. Where the best constants leave a share e of the simulated
        motion unexplained, r = regularization * e times the springs' own motion is added to the loss: sum |x - x_D|² +
        r sum |x - reference|². The minimum is that of a fit to 1 / (1 + r) of the motion: the same shape, smaller ([ZS] section 7).
        A pull of 0.03 r to the usual constants' logarithms goes with it. Motion of true springs is found exactly. 0: none.
    dropped_share
        Share of every vertex's frames, those of the greatest error, that are left out of a second fit ([ZS] figure 7). 0: none; 0.1
        is the paper's.
    seed
        Of the genetic algorithm. Every vertex draws its own numbers.
    """

    regularization: float = 1.0
    dropped_share: float = 0.0
    seed: int = 0


@dataclass(frozen=True)
class SpringFit:
    """Constants of n vertices, and how well they do.

    Attributes
    ----------
    stiffness, damping : (n,) float64
        ks, 1/s², and kd, 1/s.
    loss : (n,) float64
        Sum over all frames of the squared distance to the simulation, m² ([ZS] eq. 14); nothing is left out of it.
    reference_loss : (n,) float64
        The same without springs.
    status : (n,) int32
        `FitStatus`.
    steps : int
        Frames that were learned from, the first one of each motion, where springs start, not counted.
    """

    stiffness: FloatArray
    damping: FloatArray
    loss: FloatArray
    reference_loss: FloatArray
    status: IntArray
    steps: int

    @property
    def learned(self) -> NDArray[np.bool_]:
        """(n,) bool: vertices whose motion told their constants."""
        learned: NDArray[np.bool_] = np.isin(self.status, (FitStatus.FITTED, FitStatus.RIGID))
        return learned

    @property
    def overdamped(self) -> NDArray[np.bool_]:
        """(n,) bool: kd² - 4 ks > 0."""
        overdamped: NDArray[np.bool_] = self.damping**2 > 4.0 * self.stiffness
        return overdamped

    @property
    def rmse(self) -> float:
        """Root mean square error over learned vertices, frames and axes, m."""
        return self._root_mean(self.loss)

    @property
    def reference_rmse(self) -> float:
        """The same without springs, m."""
        return self._root_mean(self.reference_loss)

    def _root_mean(self, loss: FloatArray) -> float:
        count = int(self.learned.sum()) * self.steps * 3
        return math.sqrt(float(loss[self.learned].sum()) / count) if count else 0.0

    def save(self, path: Path | str) -> None:
        """Write the file that `simulate --springs` reads: `ks` (n,) in 1/s² and `kd` (n,) in 1/s, all or nothing."""
        write_npz(path, {"ks": self.stiffness, "kd": self.damping})


def fit_springs(
    motions: Iterable[Training],
    settings: FitSettings | None = None,
    *,
    skipped: ArrayLike | None = None,
    blocks: Callable[[Sequence[range]], Iterable[range]] = lambda blocks: blocks,
) -> SpringFit:
    """Learn the springs' constants of every vertex.

    Parameters
    ----------
    motions
        Of the same vertices; their losses are added.
    settings
        How.
    skipped : (n,) bool, optional
        Vertices that are left out, such as constrained ones, which follow the reference anyway.
    blocks
        Wraps the list of blocks of vertices, for example into a progress bar.

    Returns
    -------
    SpringFit
        The same, to the bit, for any number of threads.

    Raises
    ------
    ValueError
        Where motions have fewer than two frames, do not fit each other or are not finite, or nothing in them accelerates.
    """
    fitting = Fitting(motions, settings, skipped=skipped)
    for block in blocks(fitting.blocks):
        fitting.fit(block)
    return fitting.result()


class Fitting:
    """`fit_springs` a block of vertices at a time, for callers that have other things to do between.

    Parameters
    ----------
    motions, settings, skipped
        As for `fit_springs`.

    Attributes
    ----------
    blocks : list of range
        Vertices that `fit` takes at a time, in this order.
    """

    def __init__(
        self, motions: Iterable[Training], settings: FitSettings | None = None, *, skipped: ArrayLike | None = None
    ) -> None:
        self._motions = list(motions)
        if not self._motions:
            raise ValueError("motions: found none, expected one or more")
        count = self._motions[0].reference.shape[1]
        self._settings = _settings_of_core(settings or FitSettings())
        self._skipped = (
            np.zeros(count, dtype=np.bool_) if skipped is None else array_checks.mask("skipped", skipped, count)
        )
        self._parts: list[tuple[NDArray[Any], ...]] = []
        self.blocks = blocks_of(count)

    def fit(self, block: range) -> None:
        """Fit the next block."""
        self._parts.append(
            _core.fit_springs(*_lists(self._motions), self._skipped, block.start, len(block), self._settings)
        )

    def result(self) -> SpringFit:
        """All of it, after the last block.

        Raises
        ------
        ValueError
            Where nothing in the motions accelerates.
        """
        ks, kd, loss, reference_loss, status = (np.concatenate(column) for column in zip(*self._parts, strict=True))
        steps = sum(len(motion.reference) - 1 for motion in self._motions)
        fit = SpringFit(ks, kd, loss, reference_loss, status, steps)
        if not fit.learned.any():
            raise ValueError(
                "motions: found no vertex whose reference speeds up, slows down or turns, expected a motion that makes flesh swing"
            )
        return fit


def blocks_of(vertex_count: int) -> list[range]:
    """Vertices that are fitted in one call."""
    return [range(first, min(first + _BLOCK, vertex_count)) for first in range(0, vertex_count, _BLOCK)]


def spring_loss(
    motions: Iterable[Training], stiffness: ArrayLike, damping: ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The loss of given constants ([ZS] eq. 14), without regularization, and its exact derivatives (eqs. 15 to 20).

    Returns
    -------
    (n,) float64 each
        Loss, m²; its derivatives with respect to log ks and log kd.
    """
    ks, kd = array_checks.vector("stiffness", stiffness), array_checks.vector("damping", damping)
    loss, by_stiffness, by_damping = _core.spring_loss(*_lists(list(motions)), ks, kd)
    return loss, by_stiffness, by_damping


def share_stiff_constants(fit: SpringFit, motions: Iterable[Training]) -> tuple[SpringFit, NDArray[np.bool_]]:
    """Give all stiff, overdamped vertices one pair of constants, as [ZS] section 7 proposes.

    Such springs hardly leave their reference; the pair is the mean of theirs, in logarithms.

    Parameters
    ----------
    fit
        What `fit_springs` found.
    motions
        What it was found on, for the losses.

    Returns
    -------
    SpringFit, (n,) bool
        With the shared pair, and who shares it.
    """
    motions = list(motions)
    shortest = min(motion.dt for motion in motions)
    stiff = fit.learned & (fit.damping**2 >= 4.0 * fit.stiffness * (1.0 - 1e-9))
    stiff &= fit.stiffness * shortest**2 > _STIFF
    if not stiff.any():
        return fit, stiff
    ks, kd = fit.stiffness.copy(), fit.damping.copy()
    for values in (ks, kd):
        values[stiff] = np.exp(np.log(values[stiff]).mean())
    loss = np.where(stiff, spring_loss(motions, ks, kd)[0], fit.loss)
    return replace(fit, stiffness=ks, damping=kd, loss=loss), stiff


def _lists(motions: Sequence[Training]) -> tuple[list[FloatArray], list[FloatArray], list[float]]:
    return (
        [motion.reference for motion in motions],
        [motion.dynamic for motion in motions],
        [float(motion.dt) for motion in motions],
    )


def _settings_of_core(settings: FitSettings) -> object:
    core = _core.SpringFitSettings()
    core.regularization = settings.regularization
    core.dropped_share = settings.dropped_share
    if settings.seed < 0:
        raise ValueError(f"seed: found {settings.seed}, expected 0 or more")
    core.seed = settings.seed
    return core
