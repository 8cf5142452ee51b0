# SPDX-License-Identifier: GPL-3.0-or-later
"""Reading surface meshes from Wavefront OBJ files: no vertex is merged, split, dropped or reordered."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np

from followthrough.character import FloatArray, IntArray


def read_obj(path: Path | str) -> tuple[FloatArray, IntArray]:
    """Read vertices and faces; everything else (texture, normals, materials, groups, lines) is passed over.

    Parameters
    ----------
    path
        The file. Faces may have any number of corners from three up and count from the end (negative indices);
        polygons become fans.

    Returns
    -------
    vertices : (v, 3) float64
        In the file's units and order.
    triangles : (t, 3) int32

    Raises
    ------
    ValueError
        Where the file cannot be read, holds no face, or a line makes no sense; names the file and the line.
    """
    path = Path(path)
    if path.is_dir():
        raise ValueError(f"{path}: found a folder, expected an .obj file")
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ValueError(f"{path}: found no such file, expected an .obj file") from None
    vertices: list[tuple[float, ...]] = []
    triangles: list[tuple[int, int, int]] = []
    corner_lines: list[int] = []
    number = 0
    lines = iter(content.splitlines())
    for line in lines:
        number += 1
        first = number
        if b"\0" in line:
            raise ValueError(f"{path}: line {number}: found binary data, expected a Wavefront OBJ text file")
        while line.endswith(b"\\"):
            line = line[:-1] + b" " + next(lines, b"")
            number += 1
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        try:
            if words[0] == b"v":
                vertices.append(_vertex(words[1:]))
            elif words[0] in (b"f", b"fo"):
                corners = [_index(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError(f"found a face of {len(corners)} corners, expected 3 or more")
                triangles.extend((corners[0], b, c) for b, c in itertools.pairwise(corners[1:]))
                corner_lines.extend([first] * (len(corners) - 2))
        except ValueError as error:
            raise ValueError(f"{path}: line {first}: {error}") from None
    if not vertices:
        raise ValueError(f"{path}: found no vertices, expected a Wavefront OBJ file with lines 'v x y z'")
    if not triangles:
        raise ValueError(f"{path}: found {len(vertices)} vertices and no faces, expected lines 'f a b c'")
    corners_array = np.array(triangles, dtype=np.int64)
    outside = np.flatnonzero((corners_array >= len(vertices)).any(axis=1))
    if len(outside):
        index = int(corners_array[outside[0]].max()) + 1
        raise ValueError(
            f"{path}: line {corner_lines[outside[0]]}: found vertex {index} in a face, expected 1 to {len(vertices)}"
        )
    return np.array(vertices, dtype=np.float64), corners_array.astype(np.int32)


def _vertex(words: list[bytes]) -> tuple[float, float, float]:
    if len(words) < 3:
        raise ValueError(f"found a vertex of {len(words)} numbers, expected x y z")
    try:
        x, y, z = (float(word) for word in words[:3])
    except ValueError:
        raise ValueError(f"found {_shown(b' '.join(words))}, expected x y z") from None
    if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
        raise ValueError(f"found {_shown(b' '.join(words))}, expected finite numbers")
    return x, y, z


def _index(word: bytes, vertices_so_far: int) -> int:
    try:
        index = int(word.partition(b"/")[0])
    except ValueError:
        raise ValueError(f"found {_shown(word)} in a face, expected a vertex number") from None
    if index == 0 or not -vertices_so_far <= index <= 2**31:
        raise ValueError(f"found vertex {index} in a face, expected 1 and up, or -1 to {-vertices_so_far} from the end")
    return index - 1 if index > 0 else vertices_so_far + index


def _shown(text: bytes) -> str:
    return repr(text[:40].decode(errors="replace"))
