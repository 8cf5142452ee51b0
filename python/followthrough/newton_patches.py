# SPDX-License-Identifier: GPL-3.0-or-later
"""A frame's Newton steps as their guides see them, a pass at a time: what its training drives, and what the emulator does natively."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough import _core, array_checks
from followthrough.character import FloatArray

if TYPE_CHECKING:
    from followthrough.sequences import Sequence

Float32Array = NDArray[np.float32]
Int32Array = NDArray[np.int32]


class PatchFeatures(NamedTuple):
    """What a guide is told of f free vertices (`cpp/include/followthrough/emulator/newton_patches.hpp`).

    Attributes
    ----------
    vectors : (f, v, 3) float32
        Those that it weighs, edges.
    scalars : (f, k) float32
        Other numbers.
    """

    vectors: Float32Array
    scalars: Float32Array


class NewtonPatches:
    """The backward Euler problem of one frame, at an estimate of its end.

    Everything but positions is in units of the edge length and the frame, so that nothing else of a scene matters than its stiffness
    s = E dt² / (density edge²).

    Parameters
    ----------
    rest_positions, tets, constrained, youngs_modulus, density, dt, poisson_ratio, compression_resistance, edge_length
        As for `emulator.Emulator`.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants that are out of range, a tet without volume or a free vertex in none.
    """

    def __init__(
        self,
        rest_positions: ArrayLike,
        tets: ArrayLike,
        constrained: ArrayLike,
        youngs_modulus: ArrayLike,
        density: ArrayLike,
        dt: float,
        *,
        poisson_ratio: float = 0.45,
        compression_resistance: float = 1e5,
        edge_length: float | None = None,
    ) -> None:
        rest = array_checks.positions("rest_positions", rest_positions)
        self._core = _core.NewtonPatches(
            rest,
            array_checks.tets("tets", tets),
            array_checks.mask("constrained", constrained, len(rest)),
            array_checks.per_vertex("youngs_modulus", youngs_modulus, len(rest)),
            array_checks.per_vertex("density", density, len(rest)),
            float(dt),
            edge_length or 0.0,
            float(poisson_ratio),
            float(compression_resistance),
        )

    @classmethod
    def of_sequence(cls, sequence: Sequence, *, edge_length: float | None = None) -> Self:
        """Of the volume that a sequence describes."""
        return cls(
            sequence.rest_positions,
            sequence.tets,
            sequence.constrained,
            sequence.youngs_modulus,
            sequence.density,
            sequence.dt,
            poisson_ratio=sequence.poisson_ratio,
            compression_resistance=sequence.compression_resistance,
            edge_length=edge_length,
        )

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return int(self._core.vertex_count)

    @property
    def edge_length(self) -> float:
        """Unit of length, m."""
        return float(self._core.edge_length)

    @property
    def stiffness(self) -> FloatArray:
        """Dimensionless stiffness E dt² / (density edge²) of every vertex, (n,)."""
        stiffness: FloatArray = self._core.stiffness
        return stiffness

    @property
    def free_vertices(self) -> Int32Array:
        """The free vertices (f,), in the order of all that is said of them here."""
        vertices: Int32Array = self._core.free_vertices
        return vertices

    @property
    def edge_starts(self) -> Int32Array:
        """Where the edges of each free vertex start, (f + 1,): those of the i-th are edge_starts[i] to edge_starts[i + 1]."""
        starts: Int32Array = self._core.edge_starts
        return starts

    @property
    def neighbours(self) -> Int32Array:
        """The vertex at each edge's other end, (edges,)."""
        neighbours: Int32Array = self._core.neighbours
        return neighbours

    def begin(self, dynamic: ArrayLike, reference: ArrayLike) -> None:
        """Start a frame.

        Parameters
        ----------
        dynamic : (4, n, 3) float
            Positions u(t), u(t-1), u(t-2), u(t-3), m.
        reference : (4, n, 3) float
            Reference x(t+1), x(t), x(t-1), x(t-2), m.

        Raises
        ------
        ValueError
            On wrong shapes or numbers that are not finite.
        """
        arrays: list[FloatArray] = []
        for name, frames in (("dynamic", dynamic), ("reference", reference)):
            array = np.ascontiguousarray(frames, dtype=np.float64)
            if array.shape != (4, self.vertex_count, 3):
                raise ValueError(f"{name}: found shape {array.shape}, expected (4, {self.vertex_count}, 3)")
            arrays.append(array)
        self._core.begin(*(list(array) for array in arrays))

    def start_features(self) -> PatchFeatures:
        """What the guide of the start is told, after `begin`."""
        return _features(self._core.start_features())

    def evaluate(self, iterations: int) -> float:
        """Gradient, tangent and direction at the estimate. A step that made the energy worse is taken back first, and Newton's
        direction, or a part of it, is taken instead.

        Parameters
        ----------
        iterations
            Of the conjugate gradients, at most.

        Returns
        -------
        float
            Root mean square of the first preconditioned residual, edges: how far the estimate is off, roughly. 0 where no part
            of the direction brought the energy down either.
        """
        return float(self._core.evaluate(iterations))

    def features(self) -> PatchFeatures:
        """What a pass's guide is told, after `evaluate`."""
        return _features(self._core.features())

    def direction(self) -> Float32Array:
        """The truncated Newton direction of the free vertices (f, 3), edges."""
        direction: Float32Array = self._core.direction()
        return direction

    def move(self, step: ArrayLike, *, last: bool = False) -> None:
        """Move the free vertices of the estimate by steps (f, 3), edges.

        Parameters
        ----------
        step
            Of the free vertices (f, 3), edges.
        last
            Whether the frame's last pass makes it. Such a step must not raise the energy; those before may, by a little.

        Raises
        ------
        ValueError
            On a wrong shape or numbers that are not finite.
        """
        array = np.ascontiguousarray(step, dtype=np.float32)
        if array.shape != (len(self.free_vertices), 3):
            raise ValueError(f"step: found shape {array.shape}, expected ({len(self.free_vertices)}, 3)")
        self._core.move(array, last)

    def end_passes(self) -> bool:
        """Take the last pass's step back where it made the energy worse, and go to the reference where that has less.

        Returns
        -------
        bool
            Whether the estimate went to the reference. Passes begin again from there.
        """
        return bool(self._core.end_passes())

    def estimate(self) -> FloatArray:
        """The estimate of all vertices (n, 3), m."""
        estimate: FloatArray = self._core.estimate()
        return estimate


def _features(arrays: tuple[Float32Array, Float32Array]) -> PatchFeatures:
    vectors, scalars = arrays
    return PatchFeatures(vectors.reshape(len(vectors), -1, 3), scalars)
