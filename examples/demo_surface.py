# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces from formulas: smooth unions of round shapes, and a closed mesh of quads on their zero level.

A field is a function from points (p, 3) to signed distances (p,), negative inside. They need not be exact distances;
only the sign and a gradient that does not vanish near the surface matter.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Field = Callable[[FloatArray], FloatArray]


def ellipsoid(points: FloatArray, centre: tuple[float, float, float], radii: tuple[float, float, float]) -> FloatArray:
    """Signed distance to an ellipsoid, exact to first order at its surface: (p,)."""
    offset = points - np.asarray(centre)
    near = np.linalg.norm(offset / radii, axis=1)
    slope = np.linalg.norm(offset / np.square(radii), axis=1)
    return np.asarray(near * (near - 1.0) / np.maximum(slope, 1e-9))


def along(points: FloatArray, path: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Nearest place on a polyline (k, 3): how far along it, from 0 to 1 by corner, and the distance; (p,) each."""
    place = np.zeros(len(points))
    distance = np.full(len(points), np.inf)
    for index, (start, end) in enumerate(pairwise(path)):
        direction = end - start
        t = np.clip((points - start) @ direction / (direction @ direction), 0.0, 1.0)
        to_segment = np.linalg.norm(points - start - t[:, None] * direction, axis=1)
        nearer = to_segment < distance
        distance = np.where(nearer, to_segment, distance)
        place = np.where(nearer, (index + t) / (len(path) - 1), place)
    return place, distance


def tube(points: FloatArray, path: FloatArray, radii: FloatArray) -> FloatArray:
    """Signed distance to a tube around a polyline (k, 3) whose radius changes from corner to corner (k,): (p,)."""
    nearest = np.full(len(points), np.inf)
    for k in range(len(path) - 1):
        place, distance = along(points, path[k : k + 2])
        nearest = np.minimum(nearest, distance - radii[k] - place * (radii[k + 1] - radii[k]))
    return nearest


def smooth_path(corners: FloatArray, count: int) -> FloatArray:
    """Catmull-Rom curve through corners (k, 3), sampled at `count` places."""
    padded = np.vstack([2 * corners[0] - corners[1], corners, 2 * corners[-1] - corners[-2]])
    at = np.linspace(0.0, len(corners) - 1, count)
    first = np.minimum(at.astype(int), len(corners) - 2)
    t = (at - first)[:, None]
    a, b, c, d = (padded[first + k] for k in range(4))
    return np.asarray(0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * (b - c) + d - a) * t**3))


def smooth_union(a: FloatArray, b: FloatArray, width: float) -> FloatArray:
    """Union of two fields with a fillet about as wide as `width`."""
    overlap = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - 0.25 * width * overlap**2


def gradient(field: Field, points: FloatArray, step: float = 2e-4) -> FloatArray:
    """Gradient of a field by central differences: (p, 3)."""
    offsets = step * np.concatenate([np.eye(3), -np.eye(3)])
    values = field((points[None] + offsets[:, None]).reshape(-1, 3)).reshape(6, -1)
    return np.asarray((values[:3] - values[3:]).T / (2.0 * step))


def edges_of(quads: IntArray) -> IntArray:
    """Every edge of some quads (q, 4) once: (e, 2), smaller index first."""
    sides = np.concatenate([quads[:, [k, (k + 1) % 4]] for k in range(4)])
    return np.unique(np.sort(sides, axis=1), axis=0)


def neighbour_mean(values: FloatArray, edges: IntArray) -> FloatArray:
    """Mean of the neighbours' values (v, k) along edges (e, 2): (v, k)."""
    ends = np.concatenate([edges, edges[:, ::-1]])
    degree = np.bincount(ends[:, 0], minlength=len(values))
    total = np.column_stack(
        [np.bincount(ends[:, 0], weights=column[ends[:, 1]], minlength=len(values)) for column in values.T]
    )
    return np.asarray(total / np.maximum(degree, 1)[:, None])


def polygonise(
    field: Field, low: FloatArray, high: FloatArray, cell: float, relaxations: int = 6
) -> tuple[FloatArray, IntArray]:
    """Closed mesh of quads on the zero level of a field: surface nets, relaxed along the surface and put back on it.

    The field is symmetric about x = 0 and looked at for x > 0 only: a grid of cubes covers the box from `low` to `high`
    and its mirror image, so the mesh is symmetric, with vertices on the plane. Every cube that the surface crosses gets
    a vertex, every grid edge that it crosses a quad.

    Returns
    -------
    vertices (v, 3) and quads (q, 4), counter-clockwise seen from outside.
    """
    half = int(np.ceil(high[0] / cell)) + 1
    axes = [
        (np.arange(half) + 0.5) * cell,
        np.arange(low[1] - cell, high[1] + 2 * cell, cell),
        np.arange(low[2] - cell, high[2] + 2 * cell, cell),
    ]
    right = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    values = field(right.reshape(-1, 3)).reshape(right.shape[:3])
    grid = np.concatenate([right[::-1] * [-1.0, 1.0, 1.0], right])
    values = np.concatenate([values[::-1], values])
    shape = values.shape
    inside = values < 0

    total = np.zeros((*(n - 1 for n in shape), 3))
    crossings = np.zeros(total.shape[:3])
    for axis in range(3):
        lower = tuple(slice(0, -1) if k == axis else slice(None) for k in range(3))
        upper = tuple(slice(1, None) if k == axis else slice(None) for k in range(3))
        a, b = values[lower], values[upper]
        crossed = inside[lower] != inside[upper]
        t = np.where(crossed, a / np.where(crossed, a - b, 1.0), 0.0)[..., None]
        where = np.where(crossed[..., None], grid[lower] * (1 - t) + grid[upper] * t, 0.0)
        others = [k for k in range(3) if k != axis]
        for first in (0, 1):
            for second in (0, 1):
                part = [slice(None)] * 3
                for k, side in zip(others, (first, second), strict=True):
                    part[k] = slice(side, shape[k] - 1 + side)
                total += where[tuple(part)]
                crossings += crossed[tuple(part)]
    used = crossings > 0
    number = np.full(used.shape, -1)
    number[used] = np.arange(int(used.sum()))
    vertices = total[used] / crossings[used][:, None]

    quads = []
    for axis in range(3):
        lower = tuple(slice(0, -1) if k == axis else slice(1, -1) for k in range(3))
        upper = tuple(slice(1, None) if k == axis else slice(1, -1) for k in range(3))
        crossed = inside[lower] != inside[upper]
        u, v = (axis + 1) % 3, (axis + 2) % 3
        corner = np.argwhere(crossed)
        corner[:, [k for k in range(3) if k != axis]] += 1
        around = []
        for du, dv in ((1, 1), (0, 1), (0, 0), (1, 0)):
            at = corner.copy()
            at[:, u] -= du
            at[:, v] -= dv
            around.append(number[at[:, 0], at[:, 1], at[:, 2]])
        quad = np.column_stack(around)
        outwards = inside[lower][crossed]
        quads.append(np.where(outwards[:, None], quad, quad[:, ::-1]))
    faces = np.concatenate(quads)

    edges = edges_of(faces)
    slope = gradient(field, vertices)
    for _ in range(relaxations):
        steepness = np.maximum(np.sum(slope**2, axis=1, keepdims=True), 0.05)
        drift = 0.6 * (neighbour_mean(vertices, edges) - vertices)
        vertices = vertices + drift - slope * np.sum(drift * slope, axis=1, keepdims=True) / steepness
        slope = gradient(field, vertices)
        push = field(vertices) / np.maximum(np.sum(slope**2, axis=1), 0.05)
        vertices = vertices - np.clip(push, -0.5 * cell, 0.5 * cell)[:, None] * slope
    return vertices, faces


def ball(
    centre: FloatArray, radii: FloatArray, polar_angles: FloatArray, segments: int, pole: FloatArray
) -> tuple[FloatArray, list[tuple[int, ...]], FloatArray]:
    """Closed ellipsoid of rings about an axis: vertices (v, 3), faces, and each vertex's angle from the pole (v,).

    `polar_angles` are the rings between the poles, ascending inside (0, pi); the pole direction is `pole` (3,).
    """
    pole = pole / np.linalg.norm(pole)
    side = np.cross(pole, [0.0, 0.0, 1.0] if abs(pole[2]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, pole)
    turn = np.arange(segments) * (2 * np.pi / segments)
    circle = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up
    rings = [np.sin(a) * circle + np.cos(a) * pole for a in polar_angles]
    unit = np.vstack([pole[None], *rings, -pole[None]])
    angles = np.concatenate([[0.0], np.repeat(polar_angles, segments), [np.pi]])
    last = len(unit) - 1
    faces: list[tuple[int, ...]] = []
    for k in range(segments):
        following = (k + 1) % segments
        faces.append((0, 1 + following, 1 + k))
        for ring in range(len(polar_angles) - 1):
            start = 1 + ring * segments
            faces.append((start + k, start + following, start + segments + following, start + segments + k))
        start = 1 + (len(polar_angles) - 1) * segments
        faces.append((start + k, start + following, last))
    return unit * radii + centre, outwards(unit, faces), angles


def pipe(path: FloatArray, radii: FloatArray, segments: int) -> tuple[FloatArray, list[tuple[int, ...]]]:
    """Closed round tube around a curve (k, 3) with a radius a corner (k,): vertices and faces; its ends are points."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, tangent)
    turn = np.arange(segments) * (2 * np.pi / segments)
    rings = path[:, None] + radii[:, None, None] * (
        np.cos(turn)[None, :, None] * side[:, None] + np.sin(turn)[None, :, None] * up[:, None]
    )
    tips = np.vstack([path[0] - tangent[0] * radii[0], path[-1] + tangent[-1] * radii[-1]])
    vertices = np.vstack([tips[:1], rings.reshape(-1, 3), tips[1:]])
    last = len(vertices) - 1
    faces: list[tuple[int, ...]] = []
    for k in range(segments):
        following = (k + 1) % segments
        faces.append((0, 1 + k, 1 + following))
        for ring in range(len(path) - 1):
            start = 1 + ring * segments
            faces.append((start + following, start + k, start + segments + k, start + segments + following))
        start = 1 + (len(path) - 1) * segments
        faces.append((start + following, start + k, last))
    return vertices, outwards(vertices, faces)


def signed_volume(vertices: FloatArray, faces: list[tuple[int, ...]]) -> float:
    """Volume inside a closed mesh, positive where its faces look outwards."""
    triangles = np.array([(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)])
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def outwards(vertices: FloatArray, faces: list[tuple[int, ...]]) -> list[tuple[int, ...]]:
    """The faces of a closed mesh, all turned round where they look inwards."""
    return faces if signed_volume(vertices, faces) > 0 else [face[::-1] for face in faces]


def is_closed(faces: IntArray) -> bool:
    """Whether every edge of some faces (f, k) belongs to two of them, which run along it in opposite directions."""
    corners = faces.shape[1]
    sides = np.concatenate([faces[:, [k, (k + 1) % corners]] for k in range(corners)])
    code = sides[:, 0] * (faces.max() + 1) + sides[:, 1]
    back = sides[:, 1] * (faces.max() + 1) + sides[:, 0]
    return len(np.unique(code)) == len(code) and bool(np.isin(code, back).all())
