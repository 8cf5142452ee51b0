# SPDX-License-Identifier: GPL-3.0-or-later
"""One character's secondary motion, frame by frame: pose in, shape key offsets out. Preview, bake and command line all drive this."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from followthrough import skinning
from followthrough.character import BonePose, FloatArray, Paint, Pose, Surface
from followthrough.settings import Settings, SpringSettings
from followthrough.springs import Springs
from followthrough.volume import Volume, build_volume


class Solver(Protocol):
    """A dynamics method (`cpp/include/followthrough/solver.hpp`)."""

    def reset(self, reference: FloatArray) -> None:
        """Start over on the reference (n, 3), m."""

    def step(self, reference: FloatArray, next_reference: FloatArray | None = None) -> FloatArray:
        """Take one frame to the reference (n, 3), m, and return the dynamic positions (n, 3), m."""

    def state(self) -> Any:
        """Everything carried from frame to frame."""

    def restore(self, state: Any) -> None:
        """Go back to a state that `state` returned."""


@dataclass(frozen=True)
class Frame:
    """Result of one frame.

    Attributes
    ----------
    offsets : (v, 3) float64
        What to add to the mesh's rest vertices, in its object space, so that the rig moves them to where the motion wants them.
    displacements : (v, 3) float64
        The secondary motion itself, in the world, metres.
    residual : float
        Largest part of a displacement that no offset can reach because the rig flattens the skin there, metres.
    """

    offsets: FloatArray
    displacements: FloatArray
    residual: float


def make_springs(volume: Volume, settings: SpringSettings, dt: float) -> Springs:
    """Springs on the volume's vertices, with painted constants.

    A soft pin p strengthens the spring to ks / (1 - p) at the same damping ratio.
    """
    low, high = settings.stiffness_range
    light, heavy = settings.mass_range
    mass = light ** (1.0 - volume.mass) * heavy**volume.mass
    unit_stiffness = low ** (1.0 - volume.stiffness) * high**volume.stiffness
    unit_damping = (
        2.0 * settings.damping_ratio * np.sqrt(unit_stiffness) if settings.damping is None else settings.damping
    )
    free = 1.0 - np.where(volume.pinned, 0.0, volume.pins)
    return Springs(
        stiffness=unit_stiffness / mass / free,
        damping=unit_damping / mass / np.sqrt(free),
        dt=dt,
        pinned=volume.pinned,
    )


class SecondaryMotion:
    """Drives one solver with a character's poses.

    Parameters
    ----------
    surface, paint
        The character.
    settings
        Volume and springs.
    dt
        Seconds a frame.
    """

    def __init__(self, surface: Surface, paint: Paint, settings: Settings, dt: float) -> None:
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"dt: found {dt:g}, expected a positive number of seconds")
        self.settings = settings
        self.volume = build_volume(surface, paint, settings.volume)
        self.solver: Solver = make_springs(self.volume, settings.springs, dt)
        self._ahead: tuple[Pose, FloatArray] | None = None

    def reset(self, pose: Pose) -> Frame:
        """Start over in this pose, without secondary motion."""
        self._ahead = None
        reference = self.volume.reference(pose)
        self.solver.reset(reference)
        nothing = np.zeros_like(self.volume.surface.rest_positions)
        return Frame(offsets=nothing, displacements=nothing, residual=0.0)

    def step(self, pose: Pose, next_pose: Pose | None = None) -> Frame:
        """Take one frame to this pose; `next_pose`, where it is known, makes the target's motion smooth at this frame."""
        reference = self._reference(pose)
        next_reference = None
        if next_pose is not None:
            next_reference = self.volume.reference(next_pose)
            self._ahead = (next_pose, next_reference)
        dynamic = self.solver.step(reference, next_reference)
        displacements = self.volume.surface_displacements(dynamic, reference)
        local = displacements @ np.linalg.inv(pose.world[:3, :3]).T
        offsets, residuals = self._inverse_skin(pose, local)
        return Frame(
            offsets=offsets,
            displacements=displacements,
            residual=_longest(residuals @ pose.world[:3, :3].T),
        )

    def _reference(self, pose: Pose) -> FloatArray:
        if self._ahead is not None and self._ahead[0] is pose:
            return self._ahead[1]
        return self.volume.reference(pose)

    def _inverse_skin(self, pose: Pose, displacements: FloatArray) -> tuple[FloatArray, FloatArray]:
        surface = self.volume.surface
        if isinstance(pose, BonePose) and surface.rig is not None:
            return skinning.inverse_skin(
                surface.rest_positions,
                surface.rig.bone_indices,
                surface.rig.bone_weights,
                pose.bone_matrices,
                displacements,
                surface.rig.skinning,
                self.settings.minimum_stretch,
                surface.rig.bone_rest_matrices,
                pose.armature,
            )
        assert not isinstance(pose, BonePose)
        return skinning.invert_displacements(pose.jacobians, displacements, self.settings.minimum_stretch)


def _longest(vectors: FloatArray) -> float:
    """Length of the longest of (n, 3)."""
    return float(np.sqrt(np.einsum("ij,ij->i", vectors, vectors).max(initial=0.0)))
