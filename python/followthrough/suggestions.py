# SPDX-License-Identifier: GPL-3.0-or-later
"""A start for an artist: what is pinned, and how stiff the rest has to be so that each part of a character swings as such parts do.

Skin near bones is pinned. The free rest is filled with tets, and its *sag* is measured: how far each bit of it gives way to a
steady acceleration, whichever way that points, d(x) in s² (metres for one m/s²). A part that gives way by d at most has its lowest
natural frequency near sqrt(1.4 / d) / 2 pi, whether it is a layer of flesh on a bone (1.23 in place of 1.4), a string (1.23) or an ear that
bends (1.55). So sag says how stiff a thick belly and a long ear must be to swing alike, on the very volume that is simulated. Where
that is stiffer than paint goes, soft pins hold the rest.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from followthrough import mesh
from followthrough.character import FloatArray, Paint, Surface, flesh_thickness
from followthrough.flesh import Flesh, elastic_body, loose_vertices, paint_flesh, soft_pins
from followthrough.quasistatic import Quasistatic
from followthrough.settings import SimulationSettings, VolumeSettings
from followthrough.volume import HARD_PIN, Volume, build_volume

#: At which a part of the character is to swing, Hz.
FREQUENCY = 4.0
#: Square of a part's lowest natural frequency (rad/s) times its largest sag.
SAG_FACTOR = 1.4
#: Distances to the bones between which pins fade, as shares of what half of the skin is nearer than: long ears without bones do not count.
PINNED_DEPTH, FREE_DEPTH = 0.8, 1.8
#: Least and most stiffness that is painted.
SOFTEST, STIFFEST = 0.15, 0.9
#: How much stiffer flesh is painted where it begins to be free than where it gives way most.
ROOT_STIFFNESS = 0.2
#: A part that gives way less than so many times as far as the ridge to the next one is a part of that.
PROMINENCE = 2.0
#: Strongest soft pin.
_STRONGEST = 0.9
_ROUNDS = 2
_SMOOTHING = 3


def suggest_paint(surface: Surface, tets: Callable[[], mesh.TetMesh] | None = None) -> Paint:
    """Suggested stiffness, mass and pins of a character ([ZS] 3.1 for the pins).

    Parameters
    ----------
    surface
        The character at rest. Without an armature nothing is pinned, and everything is of medium stiffness.
    tets
        Gives what `make_tets` gives for this surface in a volume of the usual settings, where the caller makes that anyway.
    """
    count = len(surface.rest_positions)
    neutral = np.full(count, 0.5)
    if surface.rig is None or flesh_thickness(surface) <= 0:
        return Paint(stiffness=neutral, mass=neutral.copy(), pins=np.zeros(count))
    near = pins_near_bones(surface)
    paint = Paint(stiffness=neutral, mass=neutral.copy(), pins=near)
    volume = build_volume(surface, paint, VolumeSettings(), tets() if tets is not None else None)
    if (volume.pinned | loose_vertices(volume)).all():
        return paint
    stiffness, pins = mesh.interpolate(
        np.column_stack(_tuned(volume, SimulationSettings())),
        volume.tet_mesh.tets,
        volume.tet_mesh.embedding_tets,
        volume.tet_mesh.embedding_weights,
    ).T
    return Paint(
        stiffness=np.clip(stiffness, 0.0, 1.0),
        mass=neutral.copy(),
        pins=np.where(near < 1.0, np.clip(np.maximum(near, pins), 0.0, HARD_PIN - 1e-6), 1.0),
    )


def pins_near_bones(surface: Surface) -> FloatArray:
    """Pins (v,) of skin by its distance to the bones: 1 near them, 0 where the flesh is thick."""
    depth = surface.bone_distances / max(float(np.median(surface.bone_distances)), 1e-9 * surface.size)
    fade = np.clip((FREE_DEPTH - depth) / (FREE_DEPTH - PINNED_DEPTH), 0.0, 1.0)
    pins: FloatArray = fade * fade * (3.0 - 2.0 * fade)
    return pins


def sag(volume: Volume, flesh: Flesh) -> FloatArray:
    """How far each vertex (n,) of a volume gives way to a steady acceleration in the worst direction, m for 1 m/s²."""
    rest = volume.tet_mesh.vertices
    body = elastic_body(volume, flesh)
    little = 1e-3 * volume.surface.size
    moved = []
    for axis in np.eye(3):
        layer = Quasistatic(
            body,
            flesh.constrained,
            tolerance=1e-3,
            gravity=little * axis,
            pin_stiffness=soft_pins(body, flesh),
        )
        moved.append((layer.solve(rest) - rest) / little)
    farthest: FloatArray = np.linalg.norm(np.stack(moved, axis=2), ord=2, axis=(1, 2))
    return farthest


def _tuned(volume: Volume, simulation: SimulationSettings) -> tuple[FloatArray, FloatArray]:
    """Stiffness and pins (n,) painted on a volume with which its parts swing at the frequency."""
    neighbours = _Neighbours(volume)
    low, high = simulation.youngs_modulus_range
    wanted = (2.0 * math.pi * FREQUENCY) ** 2
    stiffness, pins = volume.stiffness, volume.pins
    for turn in range(_ROUNDS):
        given, flesh = _measured(volume, stiffness, pins, simulation)
        free = ~flesh.constrained
        peaks = neighbours.peaks(given, free)
        change = np.log(wanted * peaks / SAG_FACTOR) / math.log(high / low)
        if turn == 0:
            change += ROOT_STIFFNESS * (1.0 - np.sqrt(given / peaks))
        stiffness = np.where(free, np.clip(stiffness + change, SOFTEST, STIFFEST), STIFFEST)
        stiffness = neighbours.smoothed(stiffness)
    given, flesh = _measured(volume, stiffness, pins, simulation)
    free = ~flesh.constrained
    peaks = neighbours.peaks(given, free)
    missing = np.maximum(wanted - SAG_FACTOR / peaks, 0.0) / np.maximum(given / peaks, 1e-3)
    held = np.minimum(missing / (missing + flesh.rate**2), _STRONGEST)
    pins = np.maximum(pins, neighbours.smoothed(np.where(flesh.constrained, 0.0, held), free))
    return stiffness, pins


def _measured(
    volume: Volume, stiffness: FloatArray, pins: FloatArray, simulation: SimulationSettings
) -> tuple[FloatArray, Flesh]:
    flesh = paint_flesh(replace(volume, stiffness=stiffness, pins=pins), simulation)
    given = sag(volume, flesh)
    return np.maximum(given, 1e-6 * given.max(initial=1e-12)), flesh


class _Neighbours:
    """The edges of a volume's tets."""

    def __init__(self, volume: Volume) -> None:
        tets = volume.tet_mesh.tets
        self._count = len(volume.tet_mesh.vertices)
        coded = [tets[:, i].astype(np.int64) * self._count + tets[:, j] for i in range(4) for j in range(4) if i != j]
        self._pairs = np.stack(np.divmod(np.unique(np.concatenate(coded)), self._count), axis=1)
        self._starts = np.searchsorted(self._pairs[:, 0], np.arange(self._count + 1))

    def smoothed(self, values: FloatArray, among: NDArray[np.bool_] | None = None) -> FloatArray:
        """Values (n,) mixed with the means of their neighbours, where given those of `among` with each other."""
        pairs = self._pairs if among is None else self._pairs[among[self._pairs].all(axis=1)]
        degree = np.bincount(pairs[:, 0], minlength=self._count)
        for _ in range(_SMOOTHING):
            mean = np.bincount(pairs[:, 0], values[pairs[:, 1]], self._count) / np.maximum(degree, 1)
            values = np.where(degree > 0, 0.5 * (values + mean), values)
        return values

    def peaks(self, given: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
        """Largest value (n,) in the part of the body that each vertex belongs to.

        Parts are the hills of the values: what leads upwards to the same top. Hills that stand out little from the ridge to the next
        are one with it.
        """
        parent = np.arange(self._count)

        def top(vertex: int) -> int:
            while parent[vertex] != vertex:
                parent[vertex] = parent[parent[vertex]]
                vertex = parent[vertex]
            return vertex

        seen = np.zeros(self._count, dtype=bool)
        # From the highest down, a vertex joins the highest hill that it touches; hills that meet in it may become one.
        for vertex in np.argsort(-given, kind="stable").tolist():
            if not free[vertex]:
                continue
            seen[vertex] = True
            around = self._pairs[self._starts[vertex] : self._starts[vertex + 1], 1]
            tops = sorted(
                {top(other) for other in around[seen[around]].tolist() if other != vertex}, key=lambda t: -given[t]
            )
            for lower in tops[1:]:
                if given[lower] < PROMINENCE * given[vertex]:
                    parent[lower] = tops[0]
            if tops:
                parent[vertex] = tops[0]
        highest: FloatArray = np.array([given[top(vertex)] for vertex in range(self._count)])
        return highest
