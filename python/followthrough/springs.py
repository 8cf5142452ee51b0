# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamics by analytic zero-restlength springs ([ZS] sections 4 and 5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core, array_checks
from followthrough.character import FloatArray
from followthrough.solver import Solver, SolverState


class Springs(Solver):
    """Every vertex hangs on its reference by a damped spring, in closed form: stable for any constants and any dt.

    The state's arrays are positions (m), velocities (m/s), the reference and the one before it (m), whatever stiffness,
    damping and dt are.

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
    gravity
        m/s²; a vertex then rests gravity / ks from its reference. It starts on its reference all the same.

    Raises
    ------
    ValueError
        On shapes that do not fit, negative or non-finite constants, a dt that is not positive, or where gravity acts on a vertex
        that no spring holds.
    """

    def __init__(
        self,
        stiffness: ArrayLike,
        damping: ArrayLike,
        dt: float,
        pinned: ArrayLike | None = None,
        *,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        stiffness = array_checks.vector("stiffness", stiffness)
        damping = array_checks.vector("damping", damping)
        none = np.zeros(0, dtype=np.bool_)
        mask = none if pinned is None else array_checks.mask("pinned", pinned, len(stiffness))
        self._dt = float(dt)
        super().__init__(_core.Springs(stiffness, damping, self._dt, mask, array_checks.vector3("gravity", gravity)))

    @property
    def is_quick(self) -> bool:
        """Yes."""
        return True

    def evaluate(self, fraction: float, reference: ArrayLike, next_reference: ArrayLike | None = None) -> FloatArray:
        """Positions (n, 3) at a share of the frame to come, on the curve that `step` would take; changes nothing."""
        after = None if next_reference is None else array_checks.positions("next_reference", next_reference)
        here = array_checks.positions("reference", reference)
        positions: FloatArray = self._core.evaluate(float(fraction), here, after)
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
        self.restore(SolverState(arrays, len(dynamic) - 1))
