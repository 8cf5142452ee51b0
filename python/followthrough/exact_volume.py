# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes whose boundary is the surface itself [ZS 3.1], through the optional tetgen package."""

from __future__ import annotations

import importlib

import numpy as np

from followthrough.mesh import FloatArray, IntArray, TetMesh, connected_parts

#: Vertices on open borders closer than this share of the longest side are one.
WELD_DISTANCE = 1e-6


def tetrahedralize_exactly(vertices: FloatArray, triangles: IntArray, *, cell_size: float | None = None) -> TetMesh:
    """Fill a closed surface with tets; see `followthrough.mesh.tetrahedralize`.

    Parameters
    ----------
    vertices : (v, 3) float64
        Metres. Coincident ones are welded first, so seams do not count as holes.
    triangles : (t, 3) int32
    cell_size
        Tets are made no larger than a regular one with this edge, metres. None: as large as their shape allows.

    Returns
    -------
    TetMesh
        The welded surface's vertices come first, in place, so each surface vertex is embedded with weight one.

    Raises
    ------
    ValueError
        Where tetgen is not installed, or the surface is open, non-manifold or crosses itself.
    """
    welded, faces = closed_surface(vertices, triangles)
    try:
        tetgen = importlib.import_module("tetgen")
    except ImportError as error:
        raise ValueError(
            "method: found 'tetgen', but the tetgen package is not installed (pip install followthrough[tetgen]), "
            "or use method 'voxel'"
        ) from error
    corners = np.unique(welded, return_index=True)[1]
    mesher = tetgen.TetGen(np.ascontiguousarray(vertices[corners]), faces)
    options: dict[str, float | bool] = (
        {} if cell_size is None else {"fixedvolume": True, "maxvolume": cell_size**3 / (6.0 * np.sqrt(2.0))}
    )
    try:
        # No new points on the surface: its vertices are the boundary.
        nodes, tets = mesher.tetrahedralize(
            order=1, mindihedral=0.0, minratio=2.0, nobisect=True, quiet=True, **options
        )[:2]
    except RuntimeError as error:
        raise ValueError(f"triangles: tetgen cannot fill the surface ({error}); use method 'voxel'") from error
    nodes = np.ascontiguousarray(nodes, dtype=np.float64)
    tets = _positive(nodes, np.ascontiguousarray(tets, dtype=np.int32))
    count = len(corners)
    if len(nodes) < count or np.abs(nodes[:count] - vertices[corners]).max() > 0:
        raise ValueError("triangles: tetgen did not keep the surface's vertices; use method 'voxel'")
    carriers, weights = _carried_by_corners(welded, tets, len(nodes))
    parts = connected_parts(tets, len(nodes))
    edges = nodes[tets[:, [0, 0, 0, 1, 1, 2]]] - nodes[tets[:, [1, 2, 3, 2, 3, 3]]]
    return TetMesh(
        vertices=nodes,
        tets=tets,
        embedding_tets=carriers,
        embedding_weights=weights,
        cells=0,
        cell_size=float(np.linalg.norm(edges, axis=2).mean()),
        parts=int(parts.max()) + 1,
        own_offsets=np.zeros(0, dtype=np.int32),
        own_triangles=np.zeros(0, dtype=np.int32),
    )


def closed_surface(vertices: FloatArray, triangles: IntArray) -> tuple[IntArray, IntArray]:
    """Weld a surface and see that it is closed.

    Returns
    -------
    welded : (v,) int32
        Number of each vertex after welding, counted from 0 in the order of first appearance by position.
    faces : (t', 3) int32
        Faces that are not degenerate, each once.

    Raises
    ------
    ValueError
        Saying how many edges are open, or belong to more than two faces.
    """
    if not len(vertices):
        raise ValueError("vertices: is empty, expected a surface")
    if not len(triangles):
        raise ValueError("triangles: is empty, expected a surface of at least one triangle")
    if not np.isfinite(vertices).all():
        row = int(np.flatnonzero(~np.isfinite(vertices).all(axis=1))[0])
        raise ValueError(f"vertices: row {row} is not finite, expected finite numbers")
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError(f"triangles: holds an index out of range, expected 0 to {len(vertices) - 1}")
    used = np.unique(triangles)
    low, high = vertices[used].min(axis=0), vertices[used].max(axis=0)
    step = WELD_DISTANCE * float((high - low).max())
    if step <= 0:
        raise ValueError("vertices: all triangles lie in one point, expected a surface with some extent")
    keys = np.round((vertices - low) / step).astype(np.int64)
    keys[np.setdiff1d(np.arange(len(vertices)), used)] = keys[used[0]]  # loose vertices make no corner of their own
    welded = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int32)
    faces = welded[triangles]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    faces = faces[np.sort(np.unique(np.sort(faces, axis=1), axis=0, return_index=True)[1])]
    edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    shared = np.unique(edges, axis=0, return_counts=True)[1]
    for name, wrong in (("open edges", shared == 1), ("edges of more than two faces", shared > 2)):
        if wrong.any() or not len(faces):
            raise ValueError(
                f"triangles: found a surface with {int(wrong.sum())} {name}, expected a closed one for tetgen "
                "(close it, or use method 'voxel')"
            )
    return welded, np.ascontiguousarray(faces, dtype=np.int32)


def _positive(nodes: FloatArray, tets: IntArray) -> IntArray:
    """Turn every tet so that its volume is positive."""
    x = nodes[tets]
    wrong = np.linalg.det(x[:, 1:] - x[:, :1]) < 0
    tets[wrong] = tets[wrong][:, [0, 1, 3, 2]]
    return tets


def _carried_by_corners(welded: IntArray, tets: IntArray, count: int) -> tuple[IntArray, FloatArray]:
    """Embed each surface vertex in the first tet of which it is a corner."""
    tet_of = np.full(count, -1, dtype=np.int32)
    corner_of = np.zeros(count, dtype=np.int32)
    flat = tets.ravel()[::-1]
    tet_of[flat] = np.arange(len(flat), dtype=np.int32)[::-1] // 4
    corner_of[flat] = np.arange(len(flat), dtype=np.int32)[::-1] % 4
    carriers = tet_of[welded]
    if (carriers < 0).any():
        raise ValueError("triangles: tetgen left vertices of the surface out; use method 'voxel'")
    weights = np.zeros((len(welded), 4))
    weights[np.arange(len(welded)), corner_of[welded]] = 1.0
    return carriers, weights
