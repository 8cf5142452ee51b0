# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes around surfaces: tets, the embedding of a surface in them, and values carried between the two."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough import _core

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True)
class TetMesh:
    """Tets around a surface, and where the surface's vertices lie in them.

    Attributes
    ----------
    vertices : (n, 3) float64
        Metres; sorted by x, then y, then z where the method is voxel.
    tets : (m, 4) int32
        All of positive volume: ``det(x1 - x0, x2 - x0, x3 - x0) > 0``. Voxel: six a cube.
    embedding_tets : (v,) int32, embedding_weights : (v, 4) float64
        The tet that carries each vertex of the surface, and its barycentric weights there.
    cells : int
        Cubes, copies counted; 0 where the method is tetgen.
    cell_size : float
        Edge of a cube, metres; the mean length of an edge where the method is tetgen.
    parts : int
        Pieces that hang together, by shared vertices.
    own_offsets : (n + 1,) int32, own_triangles : (k,) int32
        Triangles of the surface around each vertex that are of its own part. Both empty unless parts were split.
    """

    vertices: FloatArray
    tets: IntArray
    embedding_tets: IntArray
    embedding_weights: FloatArray
    cells: int
    cell_size: float
    parts: int
    own_offsets: IntArray
    own_triangles: IntArray


def _rows(name: str, values: ArrayLike, columns: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Array of shape (rows, columns), ready for the core."""
    found = np.asarray(values)
    if found.ndim != 2 or found.shape[1] != columns:
        raise ValueError(f"{name}: found shape {found.shape}, expected (rows, {columns})")
    return _converted(name, found, dtype)


def _list(name: str, values: ArrayLike, dtype: Any) -> NDArray[Any]:
    found = np.asarray(values)
    if found.ndim != 1:
        raise ValueError(f"{name}: found shape {found.shape}, expected one number a row")
    return _converted(name, found, dtype)


def _converted(name: str, found: NDArray[Any], dtype: Any) -> NDArray[Any]:
    whole = np.issubdtype(dtype, np.integer)
    if found.dtype.kind not in ("iu" if whole else "iuf"):
        raise ValueError(
            f"{name}: found {found.dtype} numbers, expected {'whole numbers' if whole else 'real numbers'}"
        )
    if whole and found.size and (found.max() > np.iinfo(np.int32).max or found.min() < np.iinfo(np.int32).min):
        raise ValueError(f"{name}: found index {found.max()}, expected less than 2**31")
    return np.ascontiguousarray(found, dtype=dtype)


def tetrahedralize(
    vertices: ArrayLike,
    triangles: ArrayLike,
    *,
    cells: int = 25,
    cell_size: float | None = None,
    split_parts: bool = False,
    method: str = "voxel",
) -> TetMesh:
    """Make a volume of tets around a surface.

    The voxel method takes any surface: open, self-crossing, of many parts, non-manifold, with unwelded seams, faces
    that are
    degenerate, doubled or turned, parts that are inside out. It keeps the cubes of a grid, centred on the bounding
    box, that a
    triangle reaches into or whose centre is inside (winding number above one half), and cuts each in six tets [DE 3.1].

    Parameters
    ----------
    vertices : (v, 3)
        Metres.
    triangles : (t, 3) int
    cells
        Cubes along the longest side of the bounding box. Unused where `cell_size` is given.
    cell_size
        Edge of a cube, metres. The grid has as few cubes along the longest side as cover it.
    split_parts
        Do not glue parts of the body (thighs, fingers, lips) that merely come near each other: where they share a
        cube, each
        part gets a copy of it. A cube's copies count in `cells`.
    method
        "voxel", or "tetgen" for a volume whose boundary is the surface itself, which must be closed (needs the
        tetgen extra;
        `cells` and `split_parts` are then without meaning, and `cell_size` bounds the size of the tets).

    Returns
    -------
    TetMesh

    Raises
    ------
    ValueError
        Naming the argument: an empty or non-finite surface, an index out of range, cells below 1, a cell size that
        is not
        positive or would make more than 20 million cells; for tetgen, where it is not installed or the surface is
        not closed.
    """
    vertices = _rows("vertices", vertices, 3)
    triangles = _rows("triangles", triangles, 3, np.int32)
    if cell_size is not None and not cell_size > 0:
        raise ValueError(f"cell_size: found {cell_size:g}, expected a positive length")
    if method == "tetgen":
        from followthrough.exact_volume import tetrahedralize_exactly

        return tetrahedralize_exactly(vertices, triangles, cell_size=cell_size)
    if method != "voxel":
        raise ValueError(f"method: found {method!r}, expected 'voxel' or 'tetgen'")
    if cells != int(cells) or not 1 <= cells <= 2**31 - 1:
        raise ValueError(f"cells: found {cells}, expected a whole number, 1 or more")
    volume = _core.tetrahedralize(vertices, triangles, int(cells), float(cell_size or 0.0), bool(split_parts))
    return TetMesh(
        vertices=volume.vertices.copy(),
        tets=volume.tets.copy(),
        embedding_tets=volume.embedding_tets.copy(),
        embedding_weights=volume.embedding_weights.copy(),
        cells=volume.cell_count,
        cell_size=volume.cell_size,
        parts=int(connected_parts(volume.tets, len(volume.vertices)).max()) + 1,
        own_offsets=volume.own_offsets.copy(),
        own_triangles=volume.own_triangles.copy(),
    )


def connected_parts(tets: ArrayLike, vertex_count: int) -> IntArray:
    """Pieces that a tet mesh falls into; tets that share a vertex hang together.

    Returns
    -------
    (vertex_count,) int32, counted from 0 in the order of their first vertices; -1 for vertices without a tet.
    """
    result: IntArray = _core.connected_parts(_rows("tets", tets, 4, np.int32), vertex_count)
    return result


def embed(points: ArrayLike, vertices: ArrayLike, tets: ArrayLike) -> tuple[IntArray, FloatArray]:
    """Find the tet that carries each point.

    Parameters
    ----------
    points : (p, 3)
        Metres. A point outside all tets goes to the nearest one, with weights below 0 or above 1, so that an affine
        motion of
        the tet mesh moves it by the same affine motion.
    vertices : (n, 3)
        Metres, at rest.
    tets : (m, 4) int

    Returns
    -------
    embedding_tets : (p,) int32
    embedding_weights : (p, 4) float64, summing to one
    """
    carriers, weights = _core.embed(
        _rows("points", points, 3), _rows("vertices", vertices, 3), _rows("tets", tets, 4, np.int32)
    )
    return carriers, weights


def interpolate(
    values: ArrayLike, tets: ArrayLike, embedding_tets: ArrayLike, embedding_weights: ArrayLike
) -> FloatArray:
    """Values at embedded points.

    Parameters
    ----------
    values : (n, k)
        On the tet mesh's vertices.
    tets : (m, 4) int
    embedding_tets : (p,) int, embedding_weights : (p, 4)
        As from `embed`.

    Returns
    -------
    (p, k) float64
    """
    found = np.asarray(values)
    if found.ndim != 2:
        raise ValueError(f"values: found shape {found.shape}, expected (rows, columns)")
    result: FloatArray = _core.interpolate(
        _converted("values", found, np.float64),
        _rows("tets", tets, 4, np.int32),
        _list("embedding_tets", embedding_tets, np.int32),
        _rows("embedding_weights", embedding_weights, 4),
    )
    return result


class SurfaceTransfer:
    """Carries values from a surface's vertices into the volume around it [ZS 3.1].

    Vertices on the volume's boundary take the value of the closest point of the surface (of their own part, where
    parts were
    split), those inside the solution of Laplace's equation between them. Results stay in the range of the surface's
    values; what
    is non-negative and sums to one over the columns stays so.

    Parameters
    ----------
    surface_vertices : (v, 3)
        Metres, at rest.
    triangles : (t, 3) int
    tet_mesh
        The volume made around this surface.
    """

    def __init__(self, surface_vertices: ArrayLike, triangles: ArrayLike, tet_mesh: TetMesh) -> None:
        self._core = _core.SurfaceTransfer(
            _rows("surface_vertices", surface_vertices, 3),
            _rows("triangles", triangles, 3, np.int32),
            tet_mesh.vertices,
            tet_mesh.tets,
            tet_mesh.own_offsets,
            tet_mesh.own_triangles,
        )

    def __call__(self, values: ArrayLike) -> FloatArray:
        """Carry values (v, k) on the surface to values (n, k) on the volume's vertices."""
        found = np.asarray(values)
        if found.ndim != 2:
            raise ValueError(f"values: found shape {found.shape}, expected (rows, columns)")
        result: FloatArray = self._core(_converted("values", found, np.float64))
        return result


class SurfaceFollower:
    """Moves a volume with the surface in it, whatever moves that: closest points at the boundary, harmonic inside.

    Parameters
    ----------
    rest_positions : (v, 3)
        The surface at rest, in object space.
    triangles : (t, 3) int
    tet_mesh
        The volume made around the surface in metres.
    object_scale : (3, 3)
        From object space to metres.
    """

    def __init__(
        self, rest_positions: ArrayLike, triangles: ArrayLike, tet_mesh: TetMesh, object_scale: ArrayLike
    ) -> None:
        self._to_metres = _rows("object_scale", object_scale, 3)
        if self._to_metres.shape != (3, 3) or not np.isfinite(np.linalg.cond(self._to_metres)):
            raise ValueError("object_scale: found a matrix that cannot be inverted, expected an invertible (3, 3)")
        self._to_object = np.linalg.inv(self._to_metres)
        self._core = _core.SurfaceFollower(
            _rows("rest_positions", rest_positions, 3) @ self._to_metres.T,
            _rows("triangles", triangles, 3, np.int32),
            tet_mesh.vertices,
            tet_mesh.tets,
            tet_mesh.own_offsets,
            tet_mesh.own_triangles,
        )

    def __call__(self, positions: ArrayLike) -> FloatArray:
        """Volume's vertices (n, 3) for the surface's vertices as they are now (v, 3), both in object space.

        A motion of the surface that is rigid in metres moves the volume by the same rigid motion.
        """
        followed: FloatArray = self._core(_rows("positions", positions, 3) @ self._to_metres.T)
        return followed @ self._to_object.T


def closest_points(
    points: ArrayLike, vertices: ArrayLike, triangles: ArrayLike
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Closest points of a triangle surface.

    Parameters
    ----------
    points : (p, 3)
    vertices : (v, 3)
    triangles : (t, 3) int

    Returns
    -------
    closest : (p,) int32
        The triangle that holds the closest point; of equally near ones the first.
    barycentric : (p, 3) float64
        Its weights there.
    distances : (p,) float64
    """
    closest, barycentric, distances = _core.closest_points(
        _rows("points", points, 3), _rows("vertices", vertices, 3), _rows("triangles", triangles, 3, np.int32)
    )
    return closest, barycentric, distances


def winding_numbers(points: ArrayLike, vertices: ArrayLike, triangles: ArrayLike) -> FloatArray:
    """Generalized winding number of a surface around each point [Jacobson et al. 2013], exact.

    Parameters
    ----------
    points : (p, 3)
    vertices : (v, 3)
    triangles : (t, 3) int

    Returns
    -------
    (p,) float64: 1 inside a closed surface whose faces look outside, 0 outside.
    """
    result: FloatArray = _core.winding_numbers(
        _rows("points", points, 3), _rows("vertices", vertices, 3), _rows("triangles", triangles, 3, np.int32)
    )
    return result
