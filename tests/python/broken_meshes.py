# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural surfaces, sound and broken in all the ways that real characters are."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Mesh = tuple[np.ndarray, np.ndarray]


def box(sides: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Mesh:
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) * sides
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return vertices, np.array(triangles, dtype=np.int32)


def sphere(rings: int = 24, sides: int = 48, centre: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    polar, angle = np.meshgrid(np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(sides) / sides, indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(angle), np.sin(polar) * np.sin(angle), np.cos(polar)], axis=-1)
    vertices = np.concatenate([[[0, 0, 1], [0, 0, -1]], points.reshape(-1, 3)]) + centre
    k = np.arange(sides)
    after = (k + 1) % sides
    faces = [np.stack([0 * k, 2 + k, 2 + after], axis=1)]
    for ring in range(rings - 2):
        a, b = 2 + ring * sides + k, 2 + ring * sides + after
        faces += [np.stack([a, a + sides, b + sides], axis=1), np.stack([a, b + sides, b], axis=1)]
    last = 2 + (rings - 2) * sides
    faces.append(np.stack([0 * k + 1, last + after, last + k], axis=1))
    return vertices, np.concatenate(faces).astype(np.int32)


def together(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0] + [len(v) for v, _ in meshes])
    return (
        np.concatenate([v for v, _ in meshes]),
        np.concatenate([t + start for (_, t), start in zip(meshes, starts[:-1], strict=True)]).astype(np.int32),
    )


def inside_out(mesh: Mesh) -> Mesh:
    return mesh[0], np.ascontiguousarray(mesh[1][:, ::-1])


def unwelded(mesh: Mesh) -> Mesh:
    vertices, triangles = mesh
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles), dtype=np.int32).reshape(-1, 3)


def _some_turned(mesh: Mesh) -> Mesh:
    triangles = mesh[1].copy()
    triangles[::3] = triangles[::3, ::-1]
    return mesh[0], triangles


def _with_degenerate(mesh: Mesh) -> Mesh:
    return mesh[0], np.concatenate([mesh[1], [[3, 3, 7], [5, 5, 5]]]).astype(np.int32)


def _with_fin(mesh: Mesh) -> Mesh:
    """A third face on an edge: non-manifold."""
    a, b, _ = mesh[1][200]
    vertices = np.concatenate([mesh[0], [mesh[0][a] * 0.8]])
    return vertices, np.concatenate([mesh[1], [[a, b, len(mesh[0])]]]).astype(np.int32)


#: Ways to break a surface that must not change its volume at all.
HARMLESS: dict[str, Callable[[Mesh], Mesh]] = {
    "unwelded seams": unwelded,
    "inside out": inside_out,
    "some faces turned": _some_turned,
    "doubled faces": lambda mesh: (mesh[0], np.concatenate([mesh[1], mesh[1]])),
    "doubled the other way": lambda mesh: (mesh[0], np.concatenate([mesh[1], mesh[1][:, ::-1]])),
    "degenerate faces": _with_degenerate,
    "a fin inside": _with_fin,
    "loose vertices": lambda mesh: (np.concatenate([mesh[0], [[50.0, 0, 0]]]), mesh[1]),
    "unwelded, some turned": lambda mesh: unwelded(_some_turned(mesh)),
}


def forked() -> Mesh:
    """Two legs with a narrow gap: a rod bent to a horseshoe. The first half of the vertices is one leg."""
    rings, sides, radius, gap, leg = 90, 24, 0.5, 0.04, 3.0
    bend = radius + gap / 2
    total = 2 * leg + np.pi * bend
    along = total * (0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, rings)))
    turn = np.clip((along - leg) / bend, 0, np.pi)
    outward = np.stack([-np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    middle = bend * outward
    middle[:, 2] -= np.clip(leg - along, 0, None) + np.clip(along - leg - np.pi * bend, 0, None)
    tip = np.clip(np.minimum(along, total - along) / radius, 0, 1)
    thickness = radius * np.sqrt(1 - (1 - tip) ** 2)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = -np.cos(angle)[:, None, None] * outward + np.sin(angle)[:, None, None] * np.array([0, 1, 0])
    vertices = (middle + thickness[:, None] * ring).transpose(1, 0, 2).reshape(-1, 3)
    r, s = np.meshgrid(np.arange(rings - 1), np.arange(sides), indexing="ij")
    a, b = (r * sides + s).ravel(), (r * sides + (s + 1) % sides).ravel()
    triangles = np.concatenate([np.stack([a, a + sides, b + sides], axis=1), np.stack([a, b + sides, b], axis=1)])
    return vertices, triangles.astype(np.int32)
