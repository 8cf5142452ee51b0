# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamics by analytic zero-restlength springs ([ZS] sections 4 and 5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough import _core
from followthrough.character import FloatArray


@dataclass(frozen=True)
class SpringsState:
    """What `Springs` carries from frame to frame; independent of stiffness, damping and dt.

    Attributes
    ----------
    arrays : tuple of (n, 3) float64
        Positions (m), velocities (m/s), the reference and the one before it (m).
    frames : int
        Frames since the reset, -1 before the first one.
    """

    arrays: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    frames: int


class Springs:
    """Every vertex hangs on its reference by a damped spring, in closed form: stable for any constants and any dt.

    Parameters
    ----------
    stiffness : (n,) float
        ks, spring stiffness over mass, 1/s². A free spring swings at sqrt(ks) / 2 pi hertz.
    damping : (n,) float
        kd, damping over mass, 1/s. 2 sqrt(ks) is critical.
    dt
        Seconds a frame.
    pinned : (n,) bool, optional
        Vertices that follow the reference exactly.

    Raises
    ------
    ValueError
        On shapes that do not fit, negative or non-finite constants, or a dt that is not positive.
    """

    def __init__(self, stiffness: ArrayLike, damping: ArrayLike, dt: float, pinned: ArrayLike | None = None) -> None:
        stiffness = _vector("stiffness", stiffness)
        damping = _vector("damping", damping)
        mask = np.zeros(0, dtype=np.bool_) if pinned is None else np.asarray(pinned)
        if mask.ndim != 1 or mask.dtype != np.bool_:
            raise ValueError(f"pinned: found shape {mask.shape} of {mask.dtype}, expected ({len(stiffness)},) of bool")
        if pinned is not None and len(mask) != len(stiffness):
            raise ValueError(f"pinned: found shape {mask.shape}, expected ({len(stiffness)},)")
        self._dt = float(dt)
        self._core = _core.Springs(stiffness, damping, self._dt, mask)

    @property
    def core(self) -> Any:
        """The native solver, for the parts of the core that drive one."""
        return self._core

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return int(self._core.vertex_count)

    def reset(self, reference: ArrayLike) -> None:
        """Start over on the reference (n, 3), m; the first step then begins with the reference's own velocity.

        Raises
        ------
        ValueError
            On a wrong shape or non-finite numbers; the state is then unchanged.
        """
        self._core.reset(_positions("reference", reference))

    def step(self, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """Take one frame.

        Parameters
        ----------
        reference : (n, 3) float
            Where the frame to reach has the vertices without secondary motion, m.
        next_reference : (n, 3) float, optional
            The same of the frame after it, where known: the target then passes smoothly (centred slope).

        Returns
        -------
        (n, 3) float64
            Dynamic positions, m.

        Raises
        ------
        ValueError
            On a wrong shape or non-finite numbers, or before the first reset; the state is then unchanged.
        """
        after = None if next_reference is None else _positions("next_reference", next_reference)
        positions: FloatArray = self._core.step(_positions("reference", reference), after)
        return positions

    def evaluate(self, fraction: float, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """Positions (n, 3) at a share of the frame to come, on the curve that `step` would take; changes nothing."""
        after = None if next_reference is None else _positions("next_reference", next_reference)
        positions: FloatArray = self._core.evaluate(float(fraction), _positions("reference", reference), after)
        return positions

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more; the velocity is their last difference."""
        if len(dynamic) == 1:
            self.reset(reference[0])
            if np.array_equal(dynamic[0], reference[0]):
                return
        before = max(len(dynamic) - 2, 0)
        velocities = (dynamic[-1] - dynamic[before]) / self._dt
        arrays = (dynamic[-1], velocities, reference[-1], reference[before])
        self.restore(SpringsState(arrays, len(dynamic) - 1))

    def state(self) -> SpringsState:
        """Everything carried from frame to frame; `restore` resumes from it bit for bit."""
        arrays, (frames,) = self._core.state()
        positions, velocities, reference, before = arrays
        return SpringsState((positions, velocities, reference, before), frames)

    def restore(self, state: SpringsState) -> None:
        """Go back to a state that `state` returned.

        Raises
        ------
        ValueError
            Where it is not a state of so many vertices.
        """
        self._core.restore(list(state.arrays), [state.frames])


def _vector(name: str, values: ArrayLike) -> FloatArray:
    array = _numbers(name, values)
    if array.ndim != 1:
        raise ValueError(f"{name}: found shape {array.shape}, expected (n,), one value a vertex")
    return array


def _positions(name: str, values: ArrayLike) -> FloatArray:
    array = _numbers(name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: found shape {array.shape}, expected (n, 3)")
    return array


def _numbers(name: str, values: ArrayLike) -> FloatArray:
    array: NDArray[np.generic] = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: found an array of {array.dtype}, expected real numbers")
    return np.ascontiguousarray(array, dtype=np.float64)
