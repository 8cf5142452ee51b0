# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamics by a patch network [DE]: a vertex's next frame from its own last three, the reference and its neighbours."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core, array_checks
from followthrough.character import FloatArray
from followthrough.emulator_weights import EmulatorWeights
from followthrough.solver import Solver, SolverState

if TYPE_CHECKING:
    from followthrough.sequences import Sequence


class Emulator(Solver):
    """A network moves the free vertices, constrained ones take the reference.

    The state's arrays are positions of the last three frames, the newest first, then the reference of the last two, m.

    A scene of any size, frame rate and density is mapped to the network's own units such that every vertex keeps its dimensionless
    stiffness s = E dt² / (density edge²), on which alone the motion depends. Where s lies outside the range that the network was trained
    on, a UserWarning says so.

    Parameters
    ----------
    rest_positions : (n, 3) float
        Vertices at rest, m.
    tets : (m, 4) int
        Their tetrahedra; every free vertex is in one.
    constrained : (n,) bool
        Vertices that take the reference exactly.
    youngs_modulus : float or (n,) float
        Pa.
    density : float or (n,) float
        kg/m³.
    dt
        Seconds a frame.
    weights
        The network.
    gravity
        m/s². The network is shown the scene from a frame of reference that falls, where bodies have no weight, so it need not have
        learned any.
    edge_length
        Edge of the cubes that the tets fill, m; None: that of cubes of six tets with the median tet's volume.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants that are not positive, or a free vertex without mass.
    """

    def __init__(
        self,
        rest_positions: ArrayLike,
        tets: ArrayLike,
        constrained: ArrayLike,
        youngs_modulus: ArrayLike,
        density: ArrayLike,
        dt: float,
        weights: EmulatorWeights,
        *,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        edge_length: float | None = None,
    ) -> None:
        rest = array_checks.positions("rest_positions", rest_positions)
        pinned = array_checks.mask("constrained", constrained, len(rest))
        if edge_length is not None and not edge_length > 0:
            raise ValueError(f"edge_length: found {edge_length:g}, expected a positive number of metres")
        trained_on = weights.trained_on
        rings = ("edge_mlp", "edge_mlp_2", "edge_mlp_3")[: weights.rings]
        core = _core.Emulator(
            rest,
            array_checks.tets("tets", tets),
            pinned,
            array_checks.per_vertex("youngs_modulus", youngs_modulus, len(rest)),
            array_checks.per_vertex("density", density, len(rest)),
            float(dt),
            edge_length or 0.0,
            weights.layers("point_mlp"),
            [weights.layers(name) for name in rings],
            weights.layers("instance_mlp"),
            trained_on.edge_length,
            trained_on.dt,
            trained_on.density,
            array_checks.vector3("gravity", gravity),
        )
        super().__init__(core)
        self._warn_outside(self.stiffness[~pinned], trained_on.stiffness_range)

    @classmethod
    def of_sequence(
        cls,
        sequence: Sequence,
        weights: EmulatorWeights,
        *,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        edge_length: float | None = None,
    ) -> Self:
        """The emulator of the volume that a sequence describes; warns where its material is not the one that was learned."""
        for name in ("poisson_ratio", "compression_resistance"):
            found, learned = getattr(sequence, name), getattr(weights.trained_on, name)
            if not np.isclose(found, learned):
                warnings.warn(
                    f"{name}: found {found:g}, but the network learned {learned:g} and knows no other", stacklevel=2
                )
        return cls(
            sequence.rest_positions,
            sequence.tets,
            sequence.constrained,
            sequence.youngs_modulus,
            sequence.density,
            sequence.dt,
            weights,
            gravity=gravity,
            edge_length=edge_length,
        )

    @staticmethod
    def _warn_outside(stiffness: FloatArray, trained: tuple[float, float]) -> None:
        low, high = trained
        outside = (stiffness < low * (1 - 1e-6)) | (stiffness > high * (1 + 1e-6))
        if outside.any():
            warnings.warn(
                f"stiffness: found E dt²/(density edge²) of {stiffness.min():.3g} to {stiffness.max():.3g}, {outside.sum()} of "
                f"{len(stiffness)} free vertices outside the {low:.3g} to {high:.3g} that the network was trained on; "
                "the motion may be wrong there (implicit-euler has no such limit)",
                stacklevel=3,
            )

    @property
    def free_vertex_count(self) -> int:
        """Number of vertices that the network moves."""
        return int(self._core.free_vertex_count)

    @property
    def edge_count(self) -> int:
        """Neighbours of all free vertices in all rings, together."""
        return int(self._core.edge_count)

    @property
    def multiply_adds(self) -> float:
        """Multiply-adds of a step that remain after the exact savings."""
        return float(self._core.multiply_adds)

    @property
    def edge_length(self) -> float:
        """Edge of the scene's cubes, m."""
        return float(self._core.edge_length)

    @property
    def stiffness(self) -> FloatArray:
        """Dimensionless stiffness E dt² / (density edge²) of every vertex, (n,)."""
        stiffness: FloatArray = self._core.stiffness
        return stiffness

    def resume(self, dynamic: FloatArray, reference: FloatArray) -> None:
        """Continue after frames (t + 1, n, 3) that are known, t 0 or more; before the first one stands the first one."""
        frames = [dynamic[max(len(dynamic) - k, 0)] for k in (1, 2, 3)]
        references = [reference[max(len(reference) - k, 0)] for k in (1, 2)]
        self.restore(SolverState((*frames, *references), len(dynamic) - 1))
