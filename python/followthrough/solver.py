# SPDX-License-Identifier: GPL-3.0-or-later
"""The one interface of every dynamics method, over the core's (`cpp/include/followthrough/solver.hpp`)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

from numpy.typing import ArrayLike

from followthrough import array_checks
from followthrough.character import FloatArray


@dataclass(frozen=True)
class SolverState:
    """What a solver carries from frame to frame.

    Attributes
    ----------
    arrays : tuple of (n, 3) float64
        Each solver's own, positions (m) first; its class names them.
    frames : int
        Frames since the reset, -1 before the first one.
    """

    arrays: tuple[FloatArray, ...]
    frames: int


class Solver(ABC):
    """Takes a volume's vertices one frame further, given where skinning puts them (the reference).

    Parameters
    ----------
    core
        The native solver.
    """

    def __init__(self, core: Any) -> None:
        self._core = core

    @property
    def core(self) -> Any:
        """The native solver, for the parts of the core that drive one."""
        return self._core

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return int(self._core.vertex_count)

    def reset(self, reference: ArrayLike) -> FloatArray:
        """Start over on the reference (n, 3), m, moving with it.

        Returns
        -------
        (n, 3) float64
            The first frame's positions, m: the reference's own, unless a solver improves it (`quasistatic.OverQuasistatic`).

        Raises
        ------
        ValueError
            On a wrong shape or non-finite numbers; the state is then unchanged.
        """
        positions = array_checks.positions("reference", reference)
        self._core.reset(positions)
        return positions

    def step(self, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """Take one frame.

        Parameters
        ----------
        reference : (n, 3) float
            Where the frame to reach has the vertices without secondary motion, m.
        next_reference : (n, 3) float, optional
            The same of the frame after it, where known. Springs pass their target smoothly then (centred slope); finite
            elements do not look ahead.

        Returns
        -------
        (n, 3) float64
            Dynamic positions, m.

        Raises
        ------
        ValueError
            On a wrong shape or non-finite numbers, or before the first reset; the state is then unchanged.
        """
        after = None if next_reference is None else array_checks.positions("next_reference", next_reference)
        positions: FloatArray = self._core.step(array_checks.positions("reference", reference), after)
        return positions

    @property
    def is_quick(self) -> bool:
        """Whether a step takes so little that it had better leave the other cores to its caller."""
        return False

    @property
    def converged(self) -> bool:
        """Whether the last step is as exact as it was asked to be: true where a solver does not iterate."""
        return True

    @abstractmethod
    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more: their last ones become the state."""

    def state(self) -> SolverState:
        """Everything carried from frame to frame; `restore` resumes from it bit for bit."""
        arrays, (frames,) = self._core.state()
        return SolverState(tuple(arrays), frames)

    def restore(self, state: SolverState) -> None:
        """Go back to a state that `state` returned.

        Raises
        ------
        ValueError
            Where it is not a state of so many vertices.
        """
        self._core.restore(list(state.arrays), [state.frames])
