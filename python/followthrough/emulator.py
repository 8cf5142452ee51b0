# SPDX-License-Identifier: GPL-3.0-or-later
"""Dynamics by a patch network: a vertex's next frame from its own last three, the reference and its neighbours [DE], or Newton steps of
finite elements that a network corrects. The weights say which."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any, Literal, Self, get_args

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core, array_checks, newton_weights
from followthrough.character import FloatArray
from followthrough.emulator_weights import EmulatorWeights
from followthrough.solver import Solver, SolverState

if TYPE_CHECKING:
    from followthrough.sequences import Sequence

#: How the hidden layers of a patch network are computed.
Precision = Literal["float32", "bfloat16"]
PRECISIONS: tuple[Precision, ...] = get_args(Precision)


class Emulator(Solver):
    """A network moves the free vertices, constrained ones take the reference.

    The state's arrays are positions of the last three frames, the newest first, then the reference of the last two, m; those of a
    network that guides Newton steps are a frame more of either.

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
    poisson_ratio, compression_resistance
        Of the material; None: what the network was trained on. The paper's network knows no other; where they differ a UserWarning
        says so.
    pin_stiffness : (n,) float, optional
        N/m of springs that pull vertices to the reference, part of the equations that Newton steps solve. Only for networks that guide
        Newton steps.
    extra_passes, extra_iterations
        Newton passes without a network at the end of each frame, and conjugate gradient iterations of each: the more, the nearer to
        backward Euler's own answer, and the slower. Only for networks that guide Newton steps.
    precision
        Of the hidden layers. ``bfloat16`` rounds their weights and inputs to 8 significant bits, in a fraction of the time; it needs
        Linux and a processor with AMX, or AMD's AVX-512 (from Zen 4 on). Only for the paper's network.

    Raises
    ------
    ValueError
        On shapes that do not fit, constants that are not positive, a free vertex without mass, or a precision that this machine or
        network does not have.
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
        poisson_ratio: float | None = None,
        compression_resistance: float | None = None,
        pin_stiffness: ArrayLike | None = None,
        extra_passes: int = 0,
        extra_iterations: int = 16,
        precision: Precision = "float32",
    ) -> None:
        rest = array_checks.positions("rest_positions", rest_positions)
        pinned = array_checks.mask("constrained", constrained, len(rest))
        if edge_length is not None and not edge_length > 0:
            raise ValueError(f"edge_length: found {edge_length:g}, expected a positive number of metres")
        trained_on = weights.trained_on
        material = (
            trained_on.poisson_ratio if poisson_ratio is None else float(poisson_ratio),
            trained_on.compression_resistance if compression_resistance is None else float(compression_resistance),
        )
        body = (
            rest,
            array_checks.tets("tets", tets),
            pinned,
            array_checks.per_vertex("youngs_modulus", youngs_modulus, len(rest)),
            array_checks.per_vertex("density", density, len(rest)),
            float(dt),
            edge_length or 0.0,
            array_checks.vector3("gravity", gravity),
        )
        if weights.newton is None:
            if extra_passes:
                raise ValueError(
                    f"extra_passes: found {extra_passes}, expected 0 for a network that takes no Newton steps"
                )
            if pin_stiffness is not None:
                raise ValueError(
                    "pin_stiffness: found some, expected none for a network that takes no Newton steps"
                    " (controls.SoftPins holds what it moves)"
                )
            core = _patch_network(body, weights, precision)
        else:
            if precision != "float32":
                raise ValueError(
                    f"precision: found {precision}, expected float32 for a network that guides Newton steps"
                )
            schedule = weights.newton
            start, *passes = (newton_weights.layers(weights.parameters, guide) for guide in schedule.guides())
            core = _core.PatchNewton(
                *body,
                *material,
                array_checks.optional_per_vertex("pin_stiffness", pin_stiffness, len(rest)),
                start,
                list(zip(schedule.iterations, passes, strict=True)),
                schedule.most_passes,
                schedule.tolerance,
                extra_passes,
                extra_iterations,
            )
        super().__init__(core)
        self._history = 3 if weights.newton is None else 4
        self._warn_of_material(material, weights)
        self._warn_outside(self.stiffness[~pinned], trained_on.stiffness_range)

    @classmethod
    def of_sequence(
        cls,
        sequence: Sequence,
        weights: EmulatorWeights,
        *,
        gravity: ArrayLike = (0.0, 0.0, 0.0),
        edge_length: float | None = None,
        extra_passes: int = 0,
        extra_iterations: int = 16,
        precision: Precision = "float32",
    ) -> Self:
        """The emulator of the volume that a sequence describes; warns where its material is not the one that was learned."""
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
            poisson_ratio=sequence.poisson_ratio,
            compression_resistance=sequence.compression_resistance,
            extra_passes=extra_passes,
            extra_iterations=extra_iterations,
            precision=precision,
        )

    @staticmethod
    def _warn_of_material(material: tuple[float, float], weights: EmulatorWeights) -> None:
        consequence = "knows no other" if weights.newton is None else "guides others less well"
        for name, found in zip(("poisson_ratio", "compression_resistance"), material, strict=True):
            learned = getattr(weights.trained_on, name)
            if not np.isclose(found, learned):
                warnings.warn(
                    f"{name}: found {found:g}, but the network learned {learned:g} and {consequence}", stacklevel=3
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
        past, references = (3, 2) if self._history == 3 else (4, 3)
        arrays = [dynamic[max(len(dynamic) - k, 0)] for k in range(1, past + 1)]
        arrays += [reference[max(len(reference) - k, 0)] for k in range(1, references + 1)]
        self.restore(SolverState(tuple(arrays), len(dynamic) - 1))


def _patch_network(body: tuple[Any, ...], weights: EmulatorWeights, precision: Precision) -> Any:
    rings = ("edge_mlp", "edge_mlp_2", "edge_mlp_3")[: weights.rings]
    *volume, gravity = body
    return _core.Emulator(
        *volume,
        weights.layers("point_mlp"),
        [weights.layers(name) for name in rings],
        weights.layers("instance_mlp"),
        weights.trained_on.edge_length,
        weights.trained_on.dt,
        weights.trained_on.density,
        gravity,
        precision,
    )
