# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes to train on, of very different form: slabs, blobs, dumbbells, limbs, ears, tails, rings, forks. Lengths are in edges.

The characters of `characters` are for measuring, and made by none of these.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from followthrough.character import FloatArray
from followthrough.datasets.bodies import Body, body_of
from followthrough.datasets.recipes import log_uniform, unit_vector
from followthrough.datasets.skeletons import Skeleton
from followthrough.datasets.surfaces import Surface, ellipsoid, slab, together, tube

Random = np.random.Generator


def _between(random: Random, low: float, high: float) -> float:
    return low + (high - low) * random.random()


def _chain(points: FloatArray, bones: int) -> Skeleton:
    """Bones one after the other along a line."""
    places = np.linspace(0, len(points) - 1, bones + 1)
    ends = np.stack([np.interp(places, np.arange(len(points)), points[:, k]) for k in range(3)], axis=1)
    return Skeleton(ends[:-1], ends[1:], tuple(range(-1, bones - 1)))


def _arc(length: float, turn: float, points: int = 16) -> FloatArray:
    """A line of some length along x that bends towards z by an angle in all."""
    angles = turn * (np.arange(points - 1) + 0.5) / (points - 1)
    steps = length / (points - 1) * np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])


def _slab(random: Random) -> tuple[Surface, Skeleton]:
    sides = np.array([_between(random, 3, 6), _between(random, 2, 4), _between(random, 0.8, 2)])
    ends = np.array([[-0.8, 0, 0], [0.8, 0, 0]]) * sides
    return slab((0, 0, 0), sides, _between(random, 0.1, 1)), _chain(ends, 1 + int(random.random() * 2))


def _blob(random: Random) -> tuple[Surface, Skeleton]:
    axes = np.array([_between(random, 2, 5.5), _between(random, 2, 4), _between(random, 2, 4)])
    ends = np.array([[-0.9, 0, 0], [0.9, 0, 0]]) * axes * _between(random, 0.3, 1)
    return ellipsoid((0, 0, 0), axes), _chain(ends, 1)


def _dumbbell(random: Random) -> tuple[Surface, Skeleton]:
    reach = _between(random, 3, 6)
    radii = [_between(random, 1.5, 3.5), _between(random, 1.5, 3.5)]
    line = np.array([[-reach, 0, 0], [0, 0, 0], [reach, 0, 0]])
    bar = tube(line, np.full(3, _between(random, 0.8, 1.4)))
    balls = [ellipsoid(line[k], np.full(3, radius)) for k, radius in zip((0, -1), radii, strict=True)]
    return together([bar, *balls]), _chain(line, 1 + int(random.random() * 2))


def _limb(random: Random) -> tuple[Surface, Skeleton]:
    line = _arc(_between(random, 8, 18), _between(random, 0, 0.8))
    radii = np.linspace(_between(random, 1.2, 3), _between(random, 0.7, 1.8), len(line))
    return tube(line, radii), _chain(line, 2 + int(random.random() * 2))


def _ear(random: Random) -> tuple[Surface, Skeleton]:
    line = _arc(_between(random, 8, 14), _between(random, 0, 1.2))
    width = _between(random, 1.5, 3.5) * np.sin(np.pi * np.linspace(0.15, 0.9, len(line)))
    return tube(line, np.stack([np.full(len(line), _between(random, 0.6, 1)), width], axis=1), (0, 1, 0)), _chain(
        line, 3
    )


def _tail(random: Random) -> tuple[Surface, Skeleton]:
    line = _arc(_between(random, 12, 24), _between(random, 0.8, 3))
    radii = _between(random, 0.9, 1.8) * np.linspace(1, _between(random, 0.5, 1.2), len(line))
    return tube(line, radii), _chain(line, 3 + int(random.random() * 2))


def _ring(random: Random) -> tuple[Surface, Skeleton]:
    radius, turn = _between(random, 3.5, 5.5), _between(random, 4.5, 6.28)
    angles = np.linspace(0, turn, 32)
    line = radius * np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    return tube(line, np.full(32, _between(random, 0.9, 1.7)), (0, 1, 0)), _chain(line, 4)


def _fork(random: Random) -> tuple[Surface, Skeleton]:
    stem, reach, spread = _between(random, 4, 8), _between(random, 5, 9), _between(random, 0.4, 1.1)
    base = np.array([[0.0, 0, 0], [stem, 0, 0]])
    ways = [reach * np.array([np.cos(spread), 0, sign * np.sin(spread)]) for sign in (1, -1)]
    limbs = [np.stack([base[1], base[1] + way]) for way in ways]
    parts = [tube(base, np.full(2, _between(random, 1.5, 2.5)))]
    parts += [tube(limb, [_between(random, 1.2, 2), _between(random, 0.7, 1.4)], (0, 1, 0)) for limb in limbs]
    heads = np.stack([base[0], base[1], base[1]])
    tails = np.stack([base[1], limbs[0][1], limbs[1][1]])
    return together(parts), Skeleton(heads, tails, (-1, 0, 0))


#: Families of shapes by name.
FAMILIES: dict[str, Callable[[Random], tuple[Surface, Skeleton]]] = {
    "slab": _slab,
    "blob": _blob,
    "dumbbell": _dumbbell,
    "limb": _limb,
    "ear": _ear,
    "tail": _tail,
    "ring": _ring,
    "fork": _fork,
}


def random_body(random: Random, family: str) -> tuple[Body, FloatArray]:
    """A body of a family, and how its bones (b, 3) are turned at rest.

    Any of the bones, one at least, hold what is near them. Half of the bodies rest as they are filled with cubes; the others
    are bent and warped, so that their rest shape is no grid.
    """
    surface, skeleton = FAMILIES[family](random)
    bones = skeleton.bone_count
    held = [bone for bone in range(bones) if random.random() < 0.5] or [int(random.random() * bones)]
    reach = (0.0, _between(random, 0.3, 1.0))
    body = body_of(surface, skeleton, log_uniform(random, 0.8, 2.2), held, reach)
    turns = 0.8 * (2.0 * random.random((bones, 3)) - 1.0)
    turns[0] *= 4.0
    warp = _between(random, 0.1, 0.6) * np.stack([smooth_field(random, body.vertices) for _ in range(3)], axis=1)
    return body.bent(turns, warp) if random.random() < 0.5 else (body, np.zeros((bones, 3)))


def smooth_field(random: Random, points: FloatArray) -> FloatArray:
    """Smooth random values (n,) between -1 and 1 at points (n, 3): waves of 6 to 20 edges."""
    total = np.zeros(len(points))
    for _ in range(3):
        wave = unit_vector(random) * 2.0 * np.pi / _between(random, 6, 20)
        total += np.sin((points * wave).sum(axis=1) + 2.0 * np.pi * random.random()) / 3.0
    return total
