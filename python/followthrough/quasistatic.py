# SPDX-License-Identifier: GPL-3.0-or-later
"""The static equilibrium of an elastic body for one pose ([ZS] section 3.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core, array_checks
from followthrough.character import FloatArray
from followthrough.elastic import QUALITIES, ElasticBody, Quality, StepReport
from followthrough.solver import Solver, SolverState


class Quasistatic:
    """Maps a pose to where flesh rests in it: constrained vertices follow the reference, elasticity, pins and gravity cancel.

    No solver: it has no time and no velocity. It improves a reference, and any solver may then run on top
    (`OverQuasistatic`).

    Parameters
    ----------
    body
        What deforms.
    constrained : (n,) bool
        Vertices that take the reference exactly.
    quality
        "preview" bounds the work of a pose, "fine" is as good as the eye can tell, "converged" is exact.
    tolerance
        Size of what is left of the forces on free vertices, relative to the forces that hold the body; None: the quality's.
    gravity
        m/s².
    pin_stiffness : (n,) float, optional
        Springs that pull vertices to their reference, N/m.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants out of range, where no vertex is free, or where gravity acts on a part of the body
        that nothing holds.
    """

    def __init__(
        self,
        body: ElasticBody,
        constrained: ArrayLike,
        *,
        quality: Quality = "converged",
        tolerance: float | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        pin_stiffness: ArrayLike | None = None,
    ) -> None:
        if quality not in QUALITIES:
            raise ValueError(f"quality: found {quality!r}, expected {', '.join(QUALITIES)}")
        settings = getattr(_core.EquilibriumSettings, quality)()
        if tolerance is not None:
            settings.tolerance = float(tolerance)
        count = body.vertex_count
        pins = array_checks.optional_per_vertex("pin_stiffness", pin_stiffness, count)
        self._core = _core.Quasistatic(
            body._core,
            body.material,
            array_checks.mask("constrained", constrained, count),
            settings,
            array_checks.vector3("gravity", gravity),
            pins,
        )

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return int(self._core.vertex_count)

    def solve(self, reference: ArrayLike) -> FloatArray:
        """Find the equilibrium of a pose.

        The search starts from the reference or from the last equilibrium, moved along with the reference, whichever has the lower
        energy: poses along an animation are quick, and where the equilibrium is unique it does not depend on the start.

        Parameters
        ----------
        reference : (n, 3) float
            Where skinning puts the vertices, m.

        Returns
        -------
        (n, 3) float64
            Finite always; `last_solve` says whether it is an equilibrium.

        Raises
        ------
        ValueError
            On a wrong shape or non-finite numbers.
        """
        positions: FloatArray = self._core.solve(array_checks.positions("reference", reference))
        return positions

    def forget(self) -> None:
        """Start the next search from the reference alone."""
        self._core.forget()

    @property
    def last_solve(self) -> StepReport:
        """How the last search went; the residual is relative to the forces that hold the body."""
        return StepReport.of(self._core.last_solve)


class OverQuasistatic(Solver):
    """Any solver on top of static equilibria: it follows each pose's equilibrium instead of the skinned positions.

    The state's arrays are the solver's, the equilibrium of the last frame, the one that was found last (of the frame ahead, where
    that is known) and its reference.

    Parameters
    ----------
    layer
        Finds the equilibria; this one's alone from now on.
    solver
        Of as many vertices, this one's alone too. None: the equilibria themselves are the motion.

    Raises
    ------
    ValueError
        Where the numbers of vertices differ.
    """

    def __init__(self, layer: Quasistatic, solver: Solver | None = None) -> None:
        self.layer = layer
        self.solver = solver
        super().__init__(_core.OverQuasistatic(layer._core, None if solver is None else solver.core))

    @property
    def last_solve(self) -> StepReport:
        """How the search for the last frame's equilibrium went."""
        return StepReport.of(self._core.last_solve)

    @property
    def converged(self) -> bool:
        """Whether the last frame's equilibrium was reached, and the solver on top has converged."""
        return self.last_solve.converged and (self.solver is None or self.solver.converged)

    def reset(self, reference: ArrayLike) -> FloatArray:
        """Start over on the reference's equilibrium, which is returned; otherwise as `Solver.reset`."""
        super().reset(reference)
        return self.state().arrays[-3]

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more: their last ones become the state."""
        self.layer.forget()
        rests = np.array([self.layer.solve(pose) for pose in reference[-2:]])
        arrays: tuple[FloatArray, ...] = ()
        if self.solver is not None:
            self.solver.resume(dynamic[-2:], rests)
            arrays = self.solver.state().arrays
        last = array_checks.positions("reference", reference[-1])
        self.restore(SolverState((*arrays, rests[-1], rests[-1], last), len(dynamic) - 1))
