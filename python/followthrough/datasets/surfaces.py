# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed surfaces to be filled with tets. Together they may cross: what is inside any of them is inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from followthrough.character import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh whose faces look outside.

    Attributes
    ----------
    vertices : (v, 3) float64
    triangles : (t, 3) int32
    """

    vertices: FloatArray
    triangles: IntArray


def ellipsoid(centre: ArrayLike, half_axes: ArrayLike, rings: int = 24, sides: int = 48) -> Surface:
    """An ellipsoid.

    Parameters
    ----------
    centre : (3,)
    half_axes : (3,) or (3, 3)
        Lengths along x, y, z, or half axes as rows.
    rings, sides
        Faces from pole to pole, and around.
    """
    axes = np.array(half_axes, dtype=np.float64)
    if axes.ndim == 1:
        axes = np.array(np.diag(axes), dtype=np.float64)
    polar = np.linspace(0.0, np.pi, rings + 1)[1:-1]
    points = _rings(
        np.sin(polar)[:, None] * _circle(sides)[0], np.sin(polar)[:, None] * _circle(sides)[1], np.cos(polar)
    )
    vertices = np.concatenate([[[0.0, 0.0, 1.0]], points, [[0.0, 0.0, -1.0]]])
    return Surface(np.asarray(centre) + combine(vertices, axes), _lathe_triangles(len(polar), sides))


def slab(centre: ArrayLike, half_sides: ArrayLike, roundness: float = 0.3, rings: int = 24, sides: int = 48) -> Surface:
    """A box with rounded edges: a superellipsoid, with flat sides for a roundness of 0 and an ellipsoid's for 1."""
    ball = ellipsoid((0, 0, 0), (1, 1, 1), rings, sides)
    exponent = 2.0 / max(roundness, 0.05)
    size = (np.abs(ball.vertices) ** exponent).sum(axis=1, keepdims=True) ** (1.0 / exponent)
    return Surface(np.asarray(centre) + ball.vertices / size * np.asarray(half_sides), ball.triangles)


def tube(centres: ArrayLike, radii: ArrayLike, side: ArrayLike = (0.0, 0.0, 1.0), sides: int = 24) -> Surface:
    """A tube along a line, with round ends.

    Parameters
    ----------
    centres : (k, 3)
        Points of the line, two or more.
    radii : (k,) or (k, 2)
        Half widths there; of a flat tube across `side`, and along it.
    side : (3,)
        Which way is flat. Anything that is not along the line's beginning.
    sides
        Faces around.
    """
    line = np.asarray(centres, dtype=np.float64)
    widths = np.asarray(radii, dtype=np.float64)
    widths = np.broadcast_to(widths.reshape(len(line), -1), (len(line), 2))
    tangents = np.gradient(line, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    across = _carried_along(tangents, np.asarray(side, dtype=np.float64))
    along = np.cross(tangents, across)
    bend = np.linspace(0.0, np.pi / 2, 5)[1:-1]
    ends = []
    for end, outwards in ((0, -1.0), (-1, 1.0)):
        reach = widths[end].min() * np.cos(bend)[:, None] * tangents[end] * outwards
        rings = [
            (line[end] + reach[k], widths[end] * np.sin(bend[k]), across[end], along[end]) for k in range(len(bend))
        ]
        pole = line[end] + outwards * widths[end].min() * tangents[end]
        ends.append((rings if end == 0 else rings[::-1], pole))
    middle = list(zip(line, widths, across, along, strict=True))
    rings = [*ends[0][0], *middle, *ends[1][0]]
    cosine, sine = _circle(sides)
    # Counter-clockwise seen from the first end.
    points = [c + w[1] * cosine[:, None] * a - w[0] * sine[:, None] * b for c, w, a, b in rings]
    vertices = np.concatenate([ends[0][1][None], *points, ends[1][1][None]])
    return Surface(vertices, _lathe_triangles(len(rings), sides))


def combine(coefficients: FloatArray, vectors: FloatArray) -> FloatArray:
    """Sums of vectors (3, 3), rows, with coefficients (n, 3). The order of summing is fixed, unlike a matrix library's."""
    first, second, third = (coefficients[..., k : k + 1] * vectors[..., k, :] for k in range(3))
    total: FloatArray = np.add(np.add(first, second), third)
    return total


def together(surfaces: list[Surface]) -> Surface:
    """Several as one."""
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces)])
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([surface.triangles + start for surface, start in zip(surfaces, starts, strict=False)]).astype(
            np.int32
        ),
    )


def _carried_along(tangents: FloatArray, side: FloatArray) -> FloatArray:
    """Unit vectors across a line that turn no more than it does, the first one as near to `side` as can be."""
    carried = []
    for tangent in tangents:
        side = side - np.dot(side, tangent) * tangent
        side = side / np.linalg.norm(side)
        carried.append(side)
    return np.stack(carried)


def _circle(sides: int) -> tuple[FloatArray, FloatArray]:
    angle = 2.0 * np.pi * np.arange(sides) / sides
    return np.cos(angle), np.sin(angle)


def _rings(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    points: FloatArray = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], axis=-1).reshape(-1, 3)
    return points


def _lathe_triangles(rings: int, sides: int) -> IntArray:
    """Faces of a first pole, rings of vertices, and a last pole; the rings run counter-clockwise seen from the first pole."""
    here = np.arange(sides)
    there = (here + 1) % sides
    first = [np.stack([np.zeros_like(here), 1 + here, 1 + there], axis=1)]
    for ring in range(rings - 1):
        top, bottom = 1 + ring * sides, 1 + (ring + 1) * sides
        first.append(np.stack([top + here, bottom + here, bottom + there], axis=1))
        first.append(np.stack([top + here, bottom + there, top + there], axis=1))
    last = 1 + rings * sides
    ring = last - sides
    first.append(np.stack([ring + here, np.full_like(here, last), ring + there], axis=1))
    triangles: IntArray = np.concatenate(first).astype(np.int32)
    return triangles
