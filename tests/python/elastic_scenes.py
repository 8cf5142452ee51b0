# SPDX-License-Identifier: GPL-3.0-or-later
"""Bars of tets, and how the tests treat them."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.sequences import Sequence
from followthrough.simulation import simulate

Array = NDArray[np.float64]
DT = math.sqrt(0.001)
CUBE = (
    "000 100 010 001",
    "100 010 001 101",
    "010 001 101 011",
    "100 110 010 101",
    "110 101 111 011",
    "110 010 101 011",
)


def bar(nx: int, ny: int, nz: int, edge: float = 0.2) -> tuple[Array, NDArray[np.int32]]:
    """A box of cubes of six tets."""
    rest = np.array(list(itertools.product(range(nx + 1), range(ny + 1), range(nz + 1))), dtype=float) * edge
    tets = []
    for cell in itertools.product(range(nx), range(ny), range(nz)):
        for tet in CUBE:
            corners = np.array([[int(c) for c in corner] for corner in tet.split()]) + cell
            tets.append(corners @ [(ny + 1) * (nz + 1), nz + 1, 1])
    return rest, np.array(tets, dtype=np.int32)


def swinging_bar(modulus: float, phase: float, frames: int = 60) -> Sequence:
    """Three cubes that swing at one end, with their true motion."""
    rest, tets = bar(3, 1, 1)
    t = np.arange(frames)
    swing = np.stack([0 * t, 0.1 * np.sin(0.5 * t + phase), 0.05 * np.sin(0.3 * t)], axis=1)
    sequence = Sequence(
        rest_positions=rest,
        tets=tets,
        constrained=rest[:, 0] < 0.1,
        youngs_modulus=np.full(len(rest), modulus),
        dt=DT,
        reference=rest + swing[:, None],
    )
    return simulate(sequence, ImplicitEuler(ElasticBody.of_sequence(sequence), sequence.constrained, sequence.dt))


def random_rotation(random: np.random.Generator) -> Array:
    q, _ = np.linalg.qr(random.normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.linalg.det(q)))


def swung(rest: Array, frames: int) -> Iterator[Array]:
    """A motion that bends, jerks and squeezes."""
    for frame in range(frames):
        angle = 0.7 * math.sin(0.8 * frame)
        turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
        jerk = [0.2 * math.sin(1.7 * frame), 0.15 * (frame % 4 == 3), 0.1 * frame]
        yield rest @ turn.T + jerk if frame else rest.copy()


def violent(rest: Array, frames: int, seed: int) -> Iterator[Array]:
    """Teleports, flips, collapse to a point and worse."""
    random = np.random.default_rng(seed)
    middle = rest.mean(axis=0)
    reference = (rest - middle) * [-1, 1, 1] + middle
    yield reference
    for _ in range(frames):
        kind = random.integers(8)
        if kind == 0:
            reference = rest + random.normal(size=3) * 10 ** random.uniform(0, 4)
        elif kind == 1:
            reference = (rest - middle) * [1, -1, 1] + middle
        elif kind == 2:
            reference = np.tile(middle, (len(rest), 1))
        elif kind == 3:
            reference = (rest - middle) @ random_rotation(random).T + middle
        elif kind == 4:
            reference = rest + random.normal(size=rest.shape)
        elif kind == 5:
            reference = (rest - middle) * 10 ** random.uniform(0, 3) + middle
        elif kind == 6:
            reference = middle - (rest - middle)
        yield reference
