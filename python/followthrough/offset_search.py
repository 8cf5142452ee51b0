# SPDX-License-Identifier: GPL-3.0-or-later
"""Offsets at rest that a deformation known only by evaluating it turns into wanted displacements.

Newton's method for all vertices at once, each with a 3x3 Jacobian of its own that three probes measure and that is kept
from frame to frame. Where every vertex is deformed by itself (lattices, bendy bones), each evaluation corrects the
Jacobians (Broyden's rank-one update), and a step that does not bring a vertex nearer is taken back and shortened. Where
vertices pull at each other (smoothing), Anderson's acceleration finds the combination of the last steps that fits best.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from followthrough import skinning
from followthrough.character import FloatArray

#: Takes offsets (v, 3) to be added to the rest positions, returns the deformed positions (v, 3).
Deform = Callable[[FloatArray], FloatArray]

#: Evaluations after which a search ends with the best that it has found.
MOST_EVALUATIONS = 24
#: Steps within which a search must halve its largest residual, or it ends: what is left cannot be reached.
PATIENCE = 6
#: A step that leaves more than this share of the largest residual is slow: the Jacobians kept do not fit any more.
SLOW = 0.3
#: Steps shorter than this share of a probe say more about rounding than about the Jacobian.
SHORTEST_SECANT = 0.01
#: Share of a probe by which a vertex may move with others before they count as coupled.
COUPLED = 0.01
#: Steps that Anderson's acceleration combines.
DEPTH = 5


@dataclass(frozen=True)
class FoundOffsets:
    """Result of one search.

    Attributes
    ----------
    offsets : (v, 3) float64
        What to add to the rest positions.
    residuals : (v, 3) float64
        Wanted displacements less what these very offsets give.
    evaluations : int
        How often the deformation was evaluated.
    """

    offsets: FloatArray
    residuals: FloatArray
    evaluations: int


class OffsetSearch:
    """Finds offsets frame by frame, each search starting from what the last one found.

    Parameters
    ----------
    vertices
        Their number.
    tolerance
        Largest residual of a vertex at which a search ends.
    probe
        How far probes move the vertices: far enough for the deformation's rounding, near enough for its curves.
    minimum_stretch
        Singular values of the Jacobians below it are raised to it, as in `skinning.inverse_skin`; what no bounded offset can
        show stays in the residuals.
    """

    def __init__(self, vertices: int, tolerance: float, probe: float, minimum_stretch: float = 0.05) -> None:
        self._tolerance = tolerance
        self._probe = probe
        self._minimum_stretch = minimum_stretch
        self._offsets = np.zeros((vertices, 3))
        self._jacobians: FloatArray | None = None
        self._coupled: bool | None = None

    def measure(self, deform: Deform) -> FloatArray:
        """Jacobians (v, 3, 3) without offsets; the next search starts with them.

        Raises
        ------
        ValueError
            Where the deformation gives numbers that are not finite.
        """
        self._jacobians = self._measure(_Frame(deform, np.zeros_like(self._offsets)))
        return self._jacobians

    def find(self, deform: Deform, displacements: FloatArray) -> FoundOffsets:
        """Offsets that move the deformed vertices by these displacements (v, 3), in the deformed space.

        Raises
        ------
        ValueError
            Where the deformation gives numbers that are not finite.
        """
        frame = _Frame(deform, displacements)
        if not displacements.any():
            self._offsets = frame.offsets
            return frame.found()
        if self._offsets.any():
            frame.take_better(self._offsets, frame.evaluate(self._offsets))
        if self._coupled is None:
            self._coupled = self._vertices_are_coupled(frame)
        if not self._coupled:
            self._solve(frame, _VertexByVertex(frame, self._minimum_stretch, SHORTEST_SECANT * self._probe))
            # Vertices were put together from several evaluations; what is coupled after all comes out here.
            self._coupled = frame.settle() > self._tolerance
        if self._coupled:
            self._solve(frame, _AllTogether(frame, self._minimum_stretch))
        self._offsets = frame.offsets
        return frame.found()

    def _solve(self, frame: _Frame, method: _Method) -> None:
        fresh = self._jacobians is None
        method.use(self._measure(frame) if self._jacobians is None else self._jacobians)
        if not fresh and method.largest_unreachable > self._tolerance:
            method.use(self._measure(frame))
            fresh = True
        distances = [method.distance]
        while distances[-1] > self._tolerance and frame.evaluations < MOST_EVALUATIONS:
            method.step()
            distances.append(method.distance)
            if not fresh and distances[-1] > max(SLOW * distances[-2], self._tolerance):
                method.use(self._measure(frame))
                fresh, distances = True, [method.distance]
            elif len(distances) > PATIENCE and distances[-1] > 0.5 * distances[-1 - PATIENCE]:
                break
        self._jacobians = method.jacobians

    def _measure(self, frame: _Frame) -> FloatArray:
        return measure_jacobians(frame.evaluate, frame.offsets, frame.deformed, self._probe)

    def _vertices_are_coupled(self, frame: _Frame) -> bool:
        """Whether vertices that are not moved are deformed otherwise where every second one is."""
        moved = frame.offsets.copy()
        moved[::2] += self._probe
        change = frame.evaluate(moved) - frame.deformed
        return _longest(change[1::2]) > COUPLED * self._probe


def measure_jacobians(deform: Deform, offsets: FloatArray, deformed: FloatArray, probe: float) -> FloatArray:
    """Every vertex's Jacobian (v, 3, 3) by three evaluations, each with all vertices moved along an axis.

    Parameters
    ----------
    offsets, deformed : (v, 3) float64
        Where, and what the deformation makes of it.
    probe
        How far.
    """
    jacobians = np.empty((len(offsets), 3, 3))
    for axis in range(3):
        moved = offsets.copy()
        moved[:, axis] += probe
        jacobians[:, :, axis] = (deform(moved) - deformed) / probe
    return jacobians


class _Frame:
    """What is wanted in one frame, and the best offsets so far."""

    def __init__(self, deform: Deform, displacements: FloatArray) -> None:
        self._deform = deform
        self.displacements = displacements
        self.evaluations = 0
        self.offsets = np.zeros_like(displacements)
        self._still = self.evaluate(self.offsets)
        self.deformed = self._still
        self._is_mixed = False

    def evaluate(self, offsets: FloatArray) -> FloatArray:
        self.evaluations += 1
        deformed = self._deform(offsets)
        if not np.isfinite(deformed).all():
            raise ValueError("the deformed mesh has coordinates that are not finite (NaN or infinity)")
        return deformed

    def missing(self, deformed: FloatArray | None = None) -> FloatArray:
        """Part of the displacements that the best offsets, or others that were evaluated, do not give."""
        return self.displacements - ((self.deformed if deformed is None else deformed) - self._still)

    def take(self, offsets: FloatArray, deformed: FloatArray) -> None:
        """These are the best now."""
        self.offsets, self.deformed, self._is_mixed = offsets, deformed, False

    def take_better(
        self, offsets: FloatArray, deformed: FloatArray, unreachable: FloatArray | float = 0.0
    ) -> NDArray[np.bool_]:
        """Take those vertices that are nearer to what can be reached; returns which."""
        ahead = _squares(self.missing(deformed) - unreachable) < _squares(self.missing() - unreachable)
        if ahead.all():
            self.take(offsets, deformed)
        elif ahead.any():
            self.offsets = np.where(ahead[:, None], offsets, self.offsets)
            self.deformed = np.where(ahead[:, None], deformed, self.deformed)
            self._is_mixed = True
        return ahead

    def settle(self) -> float:
        """Evaluate the best offsets of all vertices together; returns by how much a vertex was off."""
        if not self._is_mixed:
            return 0.0
        mixed = self.deformed
        self.take(self.offsets, self.evaluate(self.offsets))
        return _longest(self.deformed - mixed)

    def found(self) -> FoundOffsets:
        return FoundOffsets(self.offsets, self.missing(), self.evaluations)


class _Method:
    """A way to step towards what a frame's displacements can reach."""

    def __init__(self, frame: _Frame, minimum_stretch: float) -> None:
        self._frame = frame
        self._minimum_stretch = minimum_stretch

    def use(self, jacobians: FloatArray) -> None:
        """Go on with these Jacobians."""
        self.jacobians = jacobians
        _, self._unreachable = self._invert(self._frame.displacements)

    @property
    def largest_unreachable(self) -> float:
        """Longest part of a displacement that the Jacobians say no bounded offset can show."""
        return _longest(self._unreachable)

    @property
    def distance(self) -> float:
        """Of the vertex that is farthest from what can be reached."""
        return self._distance_of(self._frame.missing())

    def step(self) -> None:
        """Evaluate once, and keep what is better."""
        raise NotImplementedError

    def _distance_of(self, missing: FloatArray) -> float:
        return _longest(missing - self._unreachable)

    def _invert(self, displacements: FloatArray) -> tuple[FloatArray, FloatArray]:
        return skinning.invert_displacements(self.jacobians, displacements, self._minimum_stretch)


class _VertexByVertex(_Method):
    """Steps where a vertex is deformed by itself."""

    def __init__(self, frame: _Frame, minimum_stretch: float, shortest_secant: float) -> None:
        super().__init__(frame, minimum_stretch)
        self._shortest_secant = shortest_secant

    def use(self, jacobians: FloatArray) -> None:
        """Go on with these Jacobians."""
        super().use(jacobians.copy())
        self._shares = np.ones(len(jacobians))

    def step(self) -> None:
        """Step where it brings a vertex nearer, and learn from it everywhere."""
        frame = self._frame
        steps, _ = self._invert(frame.missing() - self._unreachable)
        steps *= self._shares[:, None]
        offsets = frame.offsets + steps
        deformed = frame.evaluate(offsets)
        self._learn(steps, deformed - frame.deformed)
        ahead = frame.take_better(offsets, deformed, self._unreachable)
        self._shares = np.where(ahead, np.minimum(1.0, 2.0 * self._shares), 0.5 * self._shares)

    def _learn(self, steps: FloatArray, changes: FloatArray) -> None:
        """Broyden's update: the Jacobian nearest to the present one that explains the change."""
        squares = _squares(steps)
        long_enough = squares > self._shortest_secant**2
        wrong = changes - np.einsum("nij,nj->ni", self.jacobians, steps)
        scaled = np.where(long_enough[:, None], steps, 0.0) / np.where(long_enough, squares, 1.0)[:, None]
        self.jacobians += wrong[:, :, None] * scaled[:, None, :]


class _AllTogether(_Method):
    """Steps where vertices pull at each other: the Jacobians tell only how they move as one."""

    def use(self, jacobians: FloatArray) -> None:
        """Go on with these Jacobians."""
        super().use(jacobians)
        self._trial = (self._frame.offsets, self._frame.deformed)
        self._history: list[tuple[FloatArray, FloatArray]] = []

    def step(self) -> None:
        """Take Anderson's step, and keep it as the best where it is."""
        offsets, deformed = self._trial
        steps, _ = self._invert(self._frame.missing(deformed) - self._unreachable)
        self._history = [*self._history[-DEPTH:], (offsets, steps)]
        offsets = offsets + steps - self._correction()
        deformed = self._frame.evaluate(offsets)
        distance = self._distance_of(self._frame.missing(deformed))
        if distance < self.distance:
            self._frame.take(offsets, deformed)
        elif distance > 2.0 * self.distance:
            self._history = []
            offsets, deformed = self._frame.offsets, self._frame.deformed
        self._trial = (offsets, deformed)

    def _correction(self) -> FloatArray | float:
        """What the earlier steps say is wrong with the last one."""
        if len(self._history) < 2:
            return 0.0
        pairs = list(zip(self._history[:-1], self._history[1:], strict=True))
        moves = np.array([after[0] - before[0] for before, after in pairs])
        changes = np.array([after[1] - before[1] for before, after in pairs])
        # Sums by einsum, which do not depend on a number of threads.
        squares = np.einsum("anj,bnj->ab", changes, changes)
        products = np.einsum("anj,nj->a", changes, self._history[-1][1])
        weights, *_ = np.linalg.lstsq(squares, products, rcond=1e-10)
        correction: FloatArray = np.einsum("a,anj->nj", weights, moves + changes)
        return correction


def _squares(vectors: FloatArray) -> FloatArray:
    squares: FloatArray = np.einsum("ij,ij->i", vectors, vectors)
    return squares


def _longest(vectors: FloatArray) -> float:
    return float(np.sqrt(_squares(vectors).max(initial=0.0)))
