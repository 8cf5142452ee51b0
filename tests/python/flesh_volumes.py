# SPDX-License-Identifier: GPL-3.0-or-later
"""Bars of flesh, painted and shaken."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from numpy.typing import NDArray

from followthrough.character import Paint, Surface
from followthrough.flesh import FLESH_THICKNESS
from followthrough.settings import VolumeSettings
from followthrough.solver import Solver
from followthrough.volume import Volume, build_volume

Array = NDArray[np.float64]
BOX = np.array(list(itertools.product((0.0, 1.0), repeat=3)))
FACES = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
TRIANGLES = np.concatenate([FACES[:, :3], FACES[:, [0, 2, 3]]]).astype(np.int32)

#: Pascals of flesh where stiffness is neutral, for a character 1 m long.
MIDDLE = float(np.sqrt(2e3 * 1e5))


def layer_rate(density: float = 1000.0) -> float:
    """Radians a second of a layer of neutral stiffness, a tenth of the character thick, when it shears."""
    return 0.5 * np.pi * float(np.sqrt(MIDDLE / 2.9 / density)) / FLESH_THICKNESS


def bar(
    size: float = 1.0,
    pins: float = 0.0,
    parts: int = 1,
    sides: tuple[float, float, float] = (1.0, 0.2, 0.2),
    cells: int = 10,
) -> Volume:
    """A bar, everything neutral; pinned as much all over."""
    positions = np.concatenate([size * (BOX * sides + [0, 0.6 * part, 0]) for part in range(parts)])
    triangles = np.concatenate([TRIANGLES + 8 * part for part in range(parts)])
    neutral = np.full(len(positions), 0.5)
    return build_volume(
        Surface(positions, triangles),
        Paint(neutral, neutral, np.full(len(positions), pins)),
        VolumeSettings(cells=cells),
    )


def held_at_one_end(volume: Volume, strength: float = 1.0) -> Volume:
    x = volume.tet_mesh.vertices[:, 0]
    return dataclasses.replace(volume, pins=np.where(x < x.min() + 1e-9 * np.ptp(x), strength, volume.pins))


def settled(solver: Solver, reference: Array, seconds: float, dt: float) -> Array:
    solver.reset(reference)
    for _ in range(round(seconds / dt)):
        positions = solver.step(reference)
    return positions


def shaken(solver: Solver, volume: Volume, frames: int = 6) -> list[Array]:
    """Displacements while the whole volume is moved and turned, over its size."""
    rest, size = volume.tet_mesh.vertices, volume.surface.size
    solver.reset(rest)
    found = []
    for frame in range(1, frames + 1):
        angle = 0.1 * frame
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        reference = rest @ turn.T + [0, 0.05 * size * np.sin(frame), 0]
        found.append((solver.step(reference) - reference) / size)
    return found
