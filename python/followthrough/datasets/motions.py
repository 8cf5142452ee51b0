# SPDX-License-Identifier: GPL-3.0-or-later
"""Rigid motions of a core: out, back to the start, and rest [DE 3.3]."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from followthrough.character import FloatArray
from followthrough.datasets.recipes import log_uniform, unit_vector
from followthrough.datasets.surfaces import combine

#: Frames of a published motion.
PUBLISHED_FRAMES = 457
#: Intervals between them that are still before the motion, and that the core is under way; at rest again after that.
_STILL, _UNDER_WAY, _INTERVALS = 24, 336, PUBLISHED_FRAMES - 1


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """A rotation about the origin and then a translation, frame by frame.

    Attributes
    ----------
    rotations : (F, 3, 3) float64
    translations : (F, 3) float64
    """

    rotations: FloatArray
    translations: FloatArray

    def __call__(self, points: FloatArray) -> FloatArray:
        """Where points (n, 3) are, (F, n, 3)."""
        return combine(points[None], np.swapaxes(self.rotations, 1, 2)[:, None]) + self.translations[:, None]


def rotations_about(axis: ArrayLike, angles: FloatArray) -> FloatArray:
    """Rotation matrices (F, 3, 3) about a unit axis by angles (F,), radians."""
    x, y, z = np.asarray(axis, dtype=np.float64)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    along = np.array([[x * x, x * y, x * z], [x * y, y * y, y * z], [x * z, y * z, z * z]])
    turn = np.asarray(angles)[:, None, None]
    rotations: FloatArray = np.cos(turn) * (np.eye(3) - along) + np.sin(turn) * cross + along
    return rotations


def out_and_back(frames: int, speed_up: int, speed: float) -> FloatArray:
    """A distance that is 0, grows at a constant acceleration and then at constant speed, is slowed down as it was sped up, and
    comes back the same way; acceleration is thus reversed, and the core is at its start again.

    Parameters
    ----------
    frames
        All, F; the motion is under way from 24/456 to 360/456 of their intervals.
    speed_up
        Frames until the top speed, 1 to a quarter of those under way (84 of 457).
    speed
        The top speed, a frame.

    Returns
    -------
    (F,) float64
        Exactly 0 before and after.
    """
    half = max(2, 2 * ((frames - 1) * _UNDER_WAY // _INTERVALS // 4))
    start = (frames - 1) * _STILL // _INTERVALS
    speed_up = min(max(speed_up, 1), half // 2)
    ramp = (np.arange(speed_up) + 0.5) / speed_up  # half steps: the distance at whole frames is a t² / 2
    out = speed * np.cumsum(np.concatenate([ramp, np.ones(half - 2 * speed_up), ramp[::-1]]))
    distance = np.zeros(frames)
    there_and_back = np.concatenate([[0.0], out, out[-2::-1], [0.0]])
    fits = min(len(there_and_back), frames - start)
    distance[start : start + fits] = there_and_back[:fits]
    return distance


def core_motion(
    random: np.random.Generator, frames: int = PUBLISHED_FRAMES, top_speed: float = 0.14, size: float = 1.0
) -> RigidMotion:
    """A random motion of a core: out in a random direction while it turns about a random axis, back again, and rest.

    How hard it accelerates is random: the top speed is reached within 1 to 84 of 457 frames, evenly in the logarithm and
    for the translation and the turn apart, so that neither speeds nor accelerations go beyond `top_speed`.

    Parameters
    ----------
    random
        Where it comes from.
    frames
        How many, F; the phases shrink with them.
    top_speed
        Of the translation, and of what is `size` away from the axis, m a frame.
    size
        Of the core, m.
    """
    longest = max(1, (frames - 1) * _UNDER_WAY // _INTERVALS // 4)
    direction, axis = unit_vector(random), unit_vector(random)
    distances, angles = (
        out_and_back(frames, round(log_uniform(random, 1, longest)), top * (0.1 + 0.9 * random.random()))
        for top in (top_speed, top_speed / size)
    )
    return RigidMotion(rotations_about(axis, angles), distances[:, None] * direction)
