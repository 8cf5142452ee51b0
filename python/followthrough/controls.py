# SPDX-License-Identifier: GPL-3.0-or-later
"""What artists ask for on any solver: how far motion goes, how soon it dies down, what holds it back."""

from __future__ import annotations

from numpy.typing import ArrayLike

from followthrough import _core, array_checks
from followthrough.character import FloatArray
from followthrough.solver import Solver, SolverState


class _Control(Solver):
    """A solver around another one, whose own it is from now on."""

    def __init__(self, solver: Solver, core: object) -> None:
        self.solver = solver
        super().__init__(core)

    @property
    def is_quick(self) -> bool:
        """Where the solver is."""
        return self.solver.is_quick

    @property
    def converged(self) -> bool:
        """Whether the solver's last step has."""
        return self.solver.converged

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) of the solver that are known, t 0 or more."""
        self.solver.resume(dynamic, reference)


class Amplified(_Control):
    """Motion farther or less far: the displacement from the reference times a number, at the same timing.

    The state is the solver's: what it has simulated does not depend on the amplitude. Springs would move alike if they felt
    accelerations so many times as strong. Flesh would not: without any it still sags out of a pose that squeezes it.

    Parameters
    ----------
    solver
        Any.
    amplitude
        0: the reference, to the bit; 1: the solver; 0 or more.

    Raises
    ------
    ValueError
        On another amplitude.
    """

    def __init__(self, solver: Solver, amplitude: float) -> None:
        self.amplitude = float(amplitude)
        super().__init__(solver, _core.Amplified(solver.core, self.amplitude))

    def reset(self, reference: ArrayLike) -> FloatArray:
        """Start over on the reference; otherwise as `Solver.reset`."""
        here = array_checks.positions("reference", reference)
        start = self.solver.reset(here)
        return here + self.amplitude * (start - here)


class RelativeDamping(_Control):
    """Motion relative to the reference dies down sooner: mass-proportional Rayleigh damping of it.

    For solvers that have no damping of their own and whose state is their last frames. The state's arrays are the solver's, with a past
    that fits the damped velocity, and the reference, m.

    Parameters
    ----------
    solver
        Such as `emulator.Emulator`, also with soft pins or corrections.
    rate
        Relative velocities are multiplied by exp(-rate dt) in every frame, 1/s. 2 w is critical for what swings at w radians a second.
    dt
        The solver's own, s a frame.

    Raises
    ------
    ValueError
        On another kind of solver or numbers that make no sense.
    """

    def __init__(self, solver: Solver, rate: float, dt: float) -> None:
        super().__init__(solver, _core.RelativeDamping(solver.core, float(rate), float(dt)))

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more: their last ones become the state, the velocity damped."""
        self.solver.resume(dynamic, reference)
        last = array_checks.positions("reference", reference[-1])
        state = self.solver.state()
        self.restore(SolverState((*state.arrays, last), state.frames))
        if len(dynamic) > 1:
            self._core.damp(last, array_checks.positions("reference", reference[-2]))


class SoftPins(_Control):
    """Vertices drawn towards their reference after each step, for solvers without springs to hang on. The state is the solver's.

    Parameters
    ----------
    solver
        One whose state is its last frames, such as `emulator.Emulator`.
    share : (n,) float
        Of its displacement that a vertex keeps in each step: 1 is free, 0 follows the reference.

    Raises
    ------
    ValueError
        On a wrong shape, other numbers or another kind of solver.
    """

    def __init__(self, solver: Solver, share: ArrayLike) -> None:
        super().__init__(solver, _core.SoftPins(solver.core, array_checks.vector("share", share)))
