# SPDX-License-Identifier: GPL-3.0-or-later
"""A dancer for the benchmark: a body of capsules around bones, and a dance of fast turns, jumps and dead stops.

In the units of [DE]: the body is 5 tall, and frames are sqrt(0.001) s apart. Everything follows from arithmetic alone: the
same dancer on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from followthrough.character import FloatArray, IntArray
from followthrough.datasets.surfaces import Surface, together, tube

#: Seconds a frame [DE].
DT = 0.001**0.5
#: Frames from one pose of the dance to the next.
BEAT = 16


@dataclass(frozen=True)
class Bone:
    """A bone, and the capsule of flesh around it.

    Attributes
    ----------
    head, tail
        Where it starts, about which it turns, and where it ends, m.
    radius
        Of the flesh, m.
    parent
        Its parent's name; None: it hangs in the world.
    swing
        How far it turns about x, y and z at most in the dance, degrees.
    """

    head: tuple[float, float, float]
    tail: tuple[float, float, float]
    radius: float
    parent: str | None
    swing: tuple[float, float, float]


def _limbs(side: str, sign: float) -> dict[str, Bone]:
    return {
        f"upper arm {side}": Bone((sign * 0.75, 0, 3.5), (sign * 1.3, 0, 3.0), 0.27, "chest", (40, 30, 20)),
        f"forearm {side}": Bone(
            (sign * 1.3, 0, 3.0), (sign * 1.75, -0.1, 2.25), 0.25, f"upper arm {side}", (30, 15, 10)
        ),
        f"thigh {side}": Bone((sign * 0.42, 0, 2.05), (sign * 0.6, 0, 1.25), 0.36, "hips", (25, 10, 10)),
        f"shin {side}": Bone((sign * 0.6, 0, 1.25), (sign * 0.68, 0, 0.36), 0.28, f"thigh {side}", (20, 0, 0)),
    }


#: Parents come before their children.
BONES: dict[str, Bone] = {
    "hips": Bone((0, 0, 2.2), (0, 0, 2.6), 0.6, None, (12, 12, 0)),
    "chest": Bone((0, 0, 2.8), (0, 0, 3.4), 0.55, "hips", (15, 15, 20)),
    "head": Bone((0, 0, 3.8), (0, 0, 4.5), 0.48, "chest", (20, 15, 25)),
    "tail": Bone((0, 0.5, 2.1), (0, 1.0, 1.95), 0.28, "hips", (15, 0, 15)),
    **_limbs("left", 1.0),
    **_limbs("right", -1.0),
}
#: Flesh that hangs where no bone is near: centre, end and radius of capsules.
SOFT_PARTS = (((0.0, -0.35, 2.4), (0.0, -0.35, 2.45), 0.5), ((0.0, 1.0, 1.95), (0.0, 1.5, 2.15), 0.28))


def segments() -> FloatArray:
    """Heads and tails of the bones, (b, 2, 3) m."""
    return np.array([(bone.head, bone.tail) for bone in BONES.values()], dtype=np.float64)


def surface(sides: int = 24) -> Surface:
    """The skin: capsules that cross each other, of so many sides, m."""
    capsules = [(bone.head, bone.tail, bone.radius) for bone in BONES.values()] + list(SOFT_PARTS)
    return together(
        [tube([head, tail], [radius, radius], side=(0.3, 1.0, 0.2), sides=sides) for head, tail, radius in capsules]
    )


def bone_weights(points: FloatArray) -> tuple[IntArray, FloatArray]:
    """Smooth weights of the bones at points (n, 3): by distance, in terms of the flesh around each bone.

    Returns
    -------
    (n, b) int32, (n, b) float64
        Bones, and their weights; rows sum to one.
    """
    weights = np.empty((len(points), len(BONES)))
    for column, bone in enumerate(BONES.values()):
        head, along = np.array(bone.head), np.subtract(bone.tail, bone.head)
        share = np.clip((points - head) @ along / (along @ along), 0.0, 1.0)
        distance = np.linalg.norm(points - head - share[:, None] * along, axis=1)
        weights[:, column] = (distance / bone.radius + 0.2) ** -6
    weights /= weights.sum(axis=1, keepdims=True)
    return np.broadcast_to(np.arange(len(BONES), dtype=np.int32), weights.shape).copy(), weights


def pose(frame: int) -> FloatArray:
    """The dance at a frame: the bones' matrices (b, 4, 4), from rest. Frame 0 is the rest pose.

    Every beat brings another pose, reached in half to four fifths of the beat and then held. The whole body turns by up to
    half a circle on every second beat and jumps on every third.
    """
    turns, travel = _dance(frame)
    matrices: dict[str, FloatArray] = {}
    for (name, bone), angles in zip(BONES.items(), turns, strict=True):
        local = _turn_about(np.array(bone.head, dtype=np.float64), angles)
        if bone.parent is None:
            local[:3, 3] += travel
        matrices[name] = local if bone.parent is None else matrices[bone.parent] @ local
    return np.array(list(matrices.values()))


def _dance(frame: int) -> tuple[FloatArray, FloatArray]:
    beat, within = divmod(frame, BEAT)
    before, after = _key(beat), _key(beat + 1)
    arrival = BEAT * (0.5 + (0.618 * (beat + 1)) % 1.0 * 0.3)
    share = min(within / arrival, 1.0)
    eased = share * share * (3.0 - 2.0 * share)
    turns, travel = (a + eased * (b - a) for a, b in zip(before, after, strict=True))
    if beat % 3 == 0:
        travel[2] += 4.0 * 0.6 * (within / BEAT) * (1.0 - within / BEAT)
    return turns, travel


def _key(beat: int) -> tuple[FloatArray, FloatArray]:
    """Where the dance is on a beat: angles (b, 3) in radians, and how far the hips are from rest (3,)."""
    if beat == 0:
        return np.zeros((len(BONES), 3)), np.zeros(3)
    # Multiples of irrational numbers, modulo one: evenly spread, never the same twice, and no random generator to depend on.
    count = 3 * len(BONES)
    spread = (np.sqrt(np.arange(2, count + 2) * 7.0 + 3.0) * beat) % 1.0
    angles = (2.0 * spread - 1.0).reshape(-1, 3) * np.radians([bone.swing for bone in BONES.values()])
    quarters = [0, 2, 1, -1, 0, 2, 3, 1]  # of a circle, after 0, 1, 3, 5 ... beats
    cycle, place = divmod((beat + 1) // 2, len(quarters) - 1)
    angles[0, 2] += np.pi / 2 * (quarters[place] + cycle * (quarters[-1] - quarters[0]))
    stride = np.array([(0.754 * beat) % 1.0 - 0.5, (0.569 * beat) % 1.0 - 0.5, -0.15 * ((0.438 * beat) % 1.0)])
    return angles, stride * np.array([1.6, 1.6, 1.0])


def _turn_about(centre: FloatArray, angles: FloatArray) -> FloatArray:
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles), np.sin(angles)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_y @ about_x
    matrix[:3, 3] = centre - matrix[:3, :3] @ centre
    return matrix
