# SPDX-License-Identifier: GPL-3.0-or-later
"""Elastic volumes by finite elements, the ground truth of secondary motion (backward Euler) and its explicit baseline."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core, array_checks
from followthrough.character import FloatArray
from followthrough.solver import Solver, SolverState

if TYPE_CHECKING:
    from followthrough.sequences import Sequence

MaterialName = Literal["invertible-stvk", "corotational"]
#: From bounded work a frame to the exact step.
Quality = Literal["preview", "fine", "converged"]
MATERIALS: tuple[MaterialName, ...] = ("invertible-stvk", "corotational")
QUALITIES: tuple[Quality, ...] = ("preview", "fine", "converged")


class ElasticBody:
    """A tet mesh and what it is made of. A tet's modulus and density are the means of its four vertices'.

    Parameters
    ----------
    rest_positions : (n, 3) float
        Vertices at rest, m.
    tets : (m, 4) int
        Inverted ones (negative volume) are taken by their absolute volume, with a warning.
    youngs_modulus : float or (n,) float
        Pa.
    density : float or (n,) float
        kg/m³.
    poisson_ratio
        -1 to 0.5, both excluded.
    compression_resistance
        Relative to Young's modulus.
    material
        "invertible-stvk": St. Venant-Kirchhoff with compression resistance, which survives inversion.
        "corotational": corotational linear elasticity, without resistance.

    Raises
    ------
    ValueError
        On shapes that do not fit, indices out of range, constants that are not positive, tets without volume.
    """

    def __init__(
        self,
        rest_positions: ArrayLike,
        tets: ArrayLike,
        youngs_modulus: ArrayLike,
        *,
        density: ArrayLike = 1000.0,
        poisson_ratio: float = 0.45,
        compression_resistance: float = 1e5,
        material: MaterialName = "invertible-stvk",
    ) -> None:
        rest = array_checks.positions("rest_positions", rest_positions)
        if material not in MATERIALS:
            raise ValueError(f"material: found {material!r}, expected {' or '.join(map(repr, MATERIALS))}")
        self.material = material
        self._core = _core.ElasticBody(
            rest,
            array_checks.tets("tets", tets),
            array_checks.per_vertex("youngs_modulus", youngs_modulus, len(rest)),
            array_checks.per_vertex("density", density, len(rest)),
            float(poisson_ratio),
            float(compression_resistance),
        )
        if self.inverted_rest_tets:
            warnings.warn(
                f"rest_positions: {self.inverted_rest_tets} of {len(np.asarray(tets))} tets are inverted at rest; "
                "they are simulated by their absolute volume",
                stacklevel=2,
            )

    @classmethod
    def of_sequence(cls, sequence: Sequence, material: MaterialName = "invertible-stvk") -> Self:
        """The body that a sequence describes."""
        return cls(
            sequence.rest_positions,
            sequence.tets,
            sequence.youngs_modulus,
            density=sequence.density,
            poisson_ratio=sequence.poisson_ratio,
            compression_resistance=sequence.compression_resistance,
            material=material,
        )

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return int(self._core.vertex_count)

    @property
    def inverted_rest_tets(self) -> int:
        """Number of tets with negative volume at rest."""
        return int(self._core.inverted_rest_tets)

    @property
    def lumped_mass(self) -> FloatArray:
        """A quarter of each adjacent tet's mass, (n,) kg."""
        mass: FloatArray = self._core.lumped_mass
        return mass

    def energy(self, positions: ArrayLike) -> float:
        """Elastic energy at positions (n, 3), J."""
        return float(self._core.energy(array_checks.positions("positions", positions), self.material))

    def internal_forces(self, positions: ArrayLike) -> FloatArray:
        """f of M a + f = 0 at positions (n, 3): the gradient of the energy, (n, 3) N."""
        forces: FloatArray = self._core.internal_forces(array_checks.positions("positions", positions), self.material)
        return forces

    def stiffness_product(self, positions: ArrayLike, change: ArrayLike, semidefinite: bool = False) -> FloatArray:
        """Change of the internal forces for a small change (n, 3) of the positions, (n, 3) N.

        With `semidefinite`, negative eigenvalues of every tet's stress derivative count as zero.
        """
        product: FloatArray = self._core.stiffness_product(
            array_checks.positions("positions", positions),
            array_checks.positions("change", change),
            self.material,
            semidefinite,
        )
        return product

    def mass_product(self, values: ArrayLike) -> FloatArray:
        """The consistent mass matrix times values (n, 3)."""
        product: FloatArray = self._core.mass_product(array_checks.positions("values", values))
        return product


@dataclass(frozen=True)
class StepReport:
    """What became of a step, or of a search for an equilibrium.

    Attributes
    ----------
    converged : bool
        The residual is within the tolerance.
    iterations, linear_iterations : int
        Of Newton's method; of conjugate gradients, all in all.
    residual : float
        Of a step: size of M (u(t+1) - 2 u(t) + u(t-1)) + dt² f, relative to the sizes of its two parts.
    """

    converged: bool
    iterations: int
    linear_iterations: int
    residual: float

    @classmethod
    def of(cls, report: Any) -> Self:
        """The core's, copied."""
        return cls(report.converged, report.iterations, report.linear_iterations, report.residual)


class _ElasticSolver(Solver):
    """What the solvers of this module have in common."""

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more: their last ones become the state."""
        self.reset(reference[-1])
        before = dynamic[-2] if len(dynamic) > 1 else dynamic[-1]
        history = self._history(dynamic[-1], before)
        self.restore(SolverState((dynamic[-1], history, reference[-1]), len(dynamic) - 1))

    def _history(self, positions: FloatArray, before: FloatArray) -> FloatArray:
        """The state's second array."""
        raise NotImplementedError


class ImplicitEuler(_ElasticSolver):
    """Backward Euler finite elements: constrained vertices follow the reference, the rest follows them.

    A step that does not converge within the quality's limits is reported by `last_step`; its positions are finite all the same.
    The state's arrays are positions, positions a frame before, and the reference, m.

    Parameters
    ----------
    body
        What moves.
    constrained : (n,) bool
        Vertices that take the reference exactly.
    dt
        Seconds a frame.
    quality
        "preview" bounds the work of a frame, "fine" is as good as the eye can tell, "converged" is exact.
    tolerance
        Size of the residual at which a step has converged, relative to its inertial and its elastic part; None: the quality's.
    most_iterations, most_linear_iterations
        Of Newton's method in a step, and of conjugate gradients in one of those; None: the quality's.
    gravity
        m/s².
    mass_damping, stiffness_damping
        Rayleigh's alpha (1/s) and beta (s). Backward Euler damps by itself.
    pin_stiffness : (n,) float, optional
        Springs that pull vertices to their reference, N/m.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants out of range, or where no vertex is free.
    """

    def __init__(
        self,
        body: ElasticBody,
        constrained: ArrayLike,
        dt: float,
        *,
        quality: Quality = "converged",
        tolerance: float | None = None,
        most_iterations: int | None = None,
        most_linear_iterations: int | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        mass_damping: float = 0.0,
        stiffness_damping: float = 0.0,
        pin_stiffness: ArrayLike | None = None,
    ) -> None:
        if quality not in QUALITIES:
            raise ValueError(f"quality: found {quality!r}, expected {', '.join(QUALITIES)}")
        newton = getattr(_core.NewtonSettings, quality)()
        if tolerance is not None:
            newton.tolerance = float(tolerance)
        if most_iterations is not None:
            newton.most_iterations = int(most_iterations)
        if most_linear_iterations is not None:
            newton.most_linear_iterations = int(most_linear_iterations)
        pins = array_checks.optional_per_vertex("pin_stiffness", pin_stiffness, body.vertex_count)
        core = _core.ImplicitEuler(
            body._core,
            body.material,
            array_checks.mask("constrained", constrained, body.vertex_count),
            float(dt),
            newton,
            array_checks.vector3("gravity", gravity),
            float(mass_damping),
            float(stiffness_damping),
            pins,
        )
        super().__init__(core)

    def _history(self, positions: FloatArray, before: FloatArray) -> FloatArray:
        return before

    @property
    def last_step(self) -> StepReport:
        """How the last step went."""
        return StepReport.of(self._core.last_step)

    @property
    def converged(self) -> bool:
        """Whether the last step has converged."""
        return self.last_step.converged


class PredictorCorrector(Solver):
    """A quick solver's prediction as the start of Newton's method: the true solver takes over where its few iterations reach.

    What comes out is the state of both. The state's arrays are the predictor's, positions of its last frames first, and the reference, m.

    Parameters
    ----------
    predictor
        A solver whose state is its last frames, such as `emulator.Emulator`; this one's alone from now on.
    corrector
        Of the same vertices, material, constraints and dt, this one's alone too; its `most_iterations` bound the corrections of a frame.

    Raises
    ------
    ValueError
        Where they do not fit each other, or the predictor is of another kind.
    """

    def __init__(self, predictor: Solver, corrector: ImplicitEuler) -> None:
        self.predictor = predictor
        self.corrector = corrector
        super().__init__(_core.PredictorCorrector(predictor.core, corrector.core))

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more: their last ones become the state."""
        self.predictor.resume(dynamic, reference)
        state = self.predictor.state()
        last = array_checks.positions("reference", reference[-1])
        self.restore(SolverState((*state.arrays, last), state.frames))

    @property
    def last_step(self) -> StepReport:
        """How the last correction went. It need not converge: it is asked for some iterations, no more (`Solver.converged`)."""
        return StepReport.of(self._core.last_step)


class CentralDifferences(_ElasticSolver):
    """The explicit baseline of [DE, eq. 2]: cheap steps with the lumped mass, of which a frame needs many.

    The state's arrays are positions (m), velocities (m/s) and the reference (m).

    Parameters
    ----------
    body
        What moves.
    constrained : (n,) bool
        Vertices that take the reference, in a straight line over a frame.
    dt
        Seconds a frame.
    substeps
        Steps a frame; None: as many as are stable where each frame starts and where it leads. Too few, and the body explodes.
    gravity
        m/s².
    mass_damping
        Rayleigh's alpha, 1/s.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants out of range, or where no vertex is free.
    """

    def __init__(
        self,
        body: ElasticBody,
        constrained: ArrayLike,
        dt: float,
        *,
        substeps: int | None = None,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        mass_damping: float = 0.0,
    ) -> None:
        if substeps is not None and substeps < 1:
            raise ValueError(f"substeps: found {substeps}, expected 1 or more")
        self._dt = float(dt)
        core = _core.CentralDifferences(
            body._core,
            body.material,
            array_checks.mask("constrained", constrained, body.vertex_count),
            float(dt),
            substeps or 0,
            array_checks.vector3("gravity", gravity),
            float(mass_damping),
        )
        super().__init__(core)

    def _history(self, positions: FloatArray, before: FloatArray) -> FloatArray:
        return (positions - before) / self._dt

    @property
    def last_substeps(self) -> int:
        """Steps that the last frame took."""
        return int(self._core.last_substeps)

    def stable_step(self, positions: ArrayLike) -> float:
        """Longest stable step near positions (n, 3), s."""
        return float(self._core.stable_step(array_checks.positions("positions", positions)))
