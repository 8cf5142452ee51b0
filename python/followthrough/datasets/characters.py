# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters to measure on: fat, thin-limbed, eared and tailed. Lengths are in edges of a cube.

Nothing here is used to make training data, and nothing of the training shapes is used here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.bodies import Body, body_of
from followthrough.datasets.skeletons import Skeleton
from followthrough.datasets.surfaces import Surface, ellipsoid, together, tube


@dataclass(frozen=True, eq=False)
class Character:
    """A body, its bones by name, and how soft it is painted.

    Attributes
    ----------
    body : Body
        z is up, y is to the front.
    bones : tuple of str
        Names of the skeleton's bones.
    softness : (n,) float64
        What Young's modulus is divided by: above 1 on bellies, ears and tails, below on limbs and heads.
    """

    body: Body
    bones: tuple[str, ...]
    softness: FloatArray


class _Anatomy:
    """Collects a character's flesh and bones."""

    def __init__(self) -> None:
        self.flesh: list[Surface] = []
        self.names: list[str] = []
        self.heads: list[FloatArray] = []
        self.tails: list[FloatArray] = []
        self.parents: list[int] = []

    def bone(self, name: str, parent: str, head: tuple[float, ...], tail: tuple[float, ...]) -> None:
        self.parents.append(self.names.index(parent) if parent else -1)
        self.names.append(name)
        self.heads.append(np.array(head))
        self.tails.append(np.array(tail))

    def limb(self, name: str, parent: str, joints: list[tuple[float, ...]], radii: list[float]) -> None:
        """A tube around a chain of bones, named `name`, `name 2` and so on."""
        for k in range(len(joints) - 1):
            self.bone(f"{name} {k + 1}" if k else name, parent, joints[k], joints[k + 1])
            parent = self.names[-1]
        places = np.linspace(0, len(joints) - 1, 4 * len(joints))
        line = np.stack([np.interp(places, np.arange(len(joints)), np.array(joints)[:, k]) for k in range(3)], axis=1)
        self.flesh.append(tube(line, np.interp(places, np.arange(len(joints)), radii), side=(0.3, 1.0, 0.2), sides=12))

    def pair(self, name: str, parent: str, joints: list[tuple[float, ...]], radii: list[float]) -> None:
        """A limb on either side."""
        for side, sign in (("left", 1.0), ("right", -1.0)):
            self.limb(f"{side} {name}", parent, [(sign * x, y, z) for x, y, z in joints], radii)

    def ball(self, centre: tuple[float, ...], half_axes: tuple[float, ...]) -> None:
        self.flesh.append(ellipsoid(centre, half_axes, rings=14, sides=28))

    def character(
        self, free: list[str], radius: float, painted: list[tuple[tuple[float, ...], float, float]]
    ) -> Character:
        """Whole; bones hold what is near them except those named in `free`. Painted: (place, radius, softness) each."""
        skeleton = Skeleton(np.array(self.heads), np.array(self.tails), tuple(self.parents))
        held = [k for k, name in enumerate(self.names) if not any(word in name for word in free)]
        body = body_of(together(self.flesh), skeleton, radius, held)
        log_softness = np.zeros(len(body.vertices))
        for place, size, softness in painted:
            near = np.exp(-((np.linalg.norm(body.vertices - np.array(place), axis=1) / size) ** 2))
            log_softness += np.log(softness) * near
        return Character(body, tuple(self.names), np.exp(np.clip(log_softness, np.log(0.1), np.log(2.5))))


def fat_one(girth: float) -> Character:
    """A big belly on short legs."""
    anatomy = _Anatomy()
    anatomy.bone("hips", "", (0, 0, 5), (0, 0, 8.5))
    anatomy.bone("chest", "hips", (0, 0, 8.5), (0, 0, 13))
    anatomy.bone("head", "chest", (0, 0, 13), (0, 0, 17))
    anatomy.ball((0, 0.8, 8.2), (4.6 * girth, 4.4 * girth, 4.2))
    anatomy.ball((0, 0, 12), (3.4, 2.6, 3.0))
    anatomy.ball((0, 0.3, 16.2), (2.2, 2.3, 2.4))
    anatomy.pair("leg", "hips", [(2.6, 0, 5.5), (3.0, 0.3, 2.8), (3.2, 0, 0.4)], [1.7, 1.4, 1.2])
    anatomy.pair("arm", "chest", [(3.0, 0, 12.8), (6.2, 0, 11.2), (9.0, 0.5, 10.2)], [1.5, 1.2, 1.0])
    belly = ((0, 4.0 * girth, 7.5), 4.0, 2.2)
    return anatomy.character([], 1.3, [belly, ((0, 0.3, 16.2), 3.0, 0.15), ((0, -3, 9), 2.5, 0.4)])


def thin_one(length: float) -> Character:
    """Long thin arms and legs on a small trunk."""
    anatomy = _Anatomy()
    knee, hip = 5.0 * length, 9.6 * length
    anatomy.bone("hips", "", (0, 0, hip), (0, 0, hip + 2.5))
    anatomy.bone("chest", "hips", (0, 0, hip + 2.5), (0, 0, hip + 6))
    anatomy.bone("head", "chest", (0, 0, hip + 6), (0, 0, hip + 9.5))
    anatomy.ball((0, 0, hip + 3.2), (1.9, 1.5, 3.8))
    anatomy.ball((0, 0.2, hip + 8.8), (1.7, 1.8, 1.9))
    anatomy.pair("leg", "hips", [(1.3, 0, hip), (2.2, 0.4, knee), (2.8, 0, 0)], [1.1, 0.8, 0.6])
    anatomy.pair(
        "arm",
        "chest",
        [(1.7, 0, hip + 5.6), (5.6 * length, 0, hip + 4.4), (9.6 * length, 0.4, hip + 3.4)],
        [0.9, 0.7, 0.55],
    )
    calf, hand = ((2.8, 0, 1.5), 3.0, 2.0), ((-9.0 * length, 0.4, hip + 3.4), 3.0, 2.0)
    return anatomy.character(["leg 2", "right arm 2"], 0.9, [calf, hand, ((0, 0, hip + 3), 3.0, 0.2)])


def eared_one(reach: float) -> Character:
    """Long ears and a long, bent tail that no bone holds beyond their roots."""
    anatomy = _Anatomy()
    anatomy.bone("hips", "", (0, -2, 5), (0, 0, 6.5))
    anatomy.bone("chest", "hips", (0, 0, 6.5), (0, 1.5, 10))
    anatomy.bone("head", "chest", (0, 1.5, 10), (0, 3.2, 12.5))
    anatomy.ball((0, -1.2, 5.8), (3.3, 3.8, 3.2))
    anatomy.ball((0, 1.0, 9), (2.4, 2.3, 2.8))
    anatomy.ball((0, 2.6, 12), (2.1, 2.7, 2.1))
    anatomy.pair("leg", "hips", [(2.2, -1, 4.5), (3.4, 0.8, 2.2), (3.6, -0.6, 0.4)], [1.6, 1.1, 0.9])
    anatomy.pair("arm", "chest", [(1.9, 1.4, 10), (4.6, 2.8, 8.6), (6.6, 4.4, 7.0)], [1.1, 0.9, 0.8])
    for side, sign in (("left", 1.0), ("right", -1.0)):
        tip = (sign * 3.6, 0.4, 12.5 + 9.0 * reach)
        line = np.linspace((sign * 1.1, 2.2, 13.2), tip, 10)
        width = 1.6 * np.sin(np.pi * np.linspace(0.2, 0.92, 10))
        anatomy.flesh.append(tube(line, np.stack([np.full(10, 0.7), width], axis=1), side=(1, 0, 0)))
        anatomy.bone(f"{side} ear", "head", tuple(line[0]), tuple(line[2]))
    angles = np.linspace(0, 2.2, 14)
    line = np.array([0, -4.2, 5.0]) + 5.0 * reach * np.stack([0 * angles, -np.sin(angles), 1 - np.cos(angles)], axis=1)
    anatomy.flesh.append(tube(line, np.linspace(1.5, 0.9, 14), side=(1, 0, 0)))
    anatomy.bone("tail", "hips", tuple(line[0]), tuple(line[3]))
    ears = [((sign * 3.0, 0.8, 12.5 + 6.0 * reach), 3.5, 1.8) for sign in (1.0, -1.0)]
    return anatomy.character([], 1.2, [*ears, (tuple(line[-1]), 4.0, 2.2), ((0, 2.6, 12), 2.5, 0.2)])
