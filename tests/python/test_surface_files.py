# SPDX-License-Identifier: GPL-3.0-or-later
"""OBJ files: every vertex in its place, and a line number for what makes no sense."""

from pathlib import Path

import numpy as np
import pytest

from followthrough.surface_files import read_obj

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"


def read(tmp_path: Path, content: str | bytes) -> tuple[np.ndarray, np.ndarray]:
    path = tmp_path / "a.obj"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_obj(path)


def test_polygons_become_fans_and_everything_else_is_passed_over(tmp_path: Path) -> None:
    content = (
        "# a comment\nmtllib a.mtl\no square\n" + SQUARE + "vt 0 0\nvn 0 0 1\nusemtl red\ns 1\n"
        "f 1/1/1 2/1/1 3//1 4 # corner forms\nl 1 2\np 1\n"
    )
    vertices, triangles = read(tmp_path, content)
    assert vertices.dtype == np.float64 and triangles.dtype == np.int32
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [0, 2, 3]])


def test_vertices_are_never_merged_or_dropped(tmp_path: Path) -> None:
    vertices, triangles = read(tmp_path, SQUARE + SQUARE + "v 9 9 9\nf 1 2 3\nf 5 6 7\nf 1 1 1\n")
    assert len(vertices) == 9
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [4, 5, 6], [0, 0, 0]])


def test_negative_indices_count_from_the_last_vertex_so_far(tmp_path: Path) -> None:
    _, triangles = read(tmp_path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 0 0 1\nf -1 -2 -3\n")
    np.testing.assert_array_equal(triangles, [[0, 1, 2], [3, 2, 1]])


def test_line_ends_continuations_extra_numbers_and_foreign_letters(tmp_path: Path) -> None:
    content = b"# caf\xe9\r\nv 0 0 0 1.0\r\nv 1 0 0 0.5 0.5 0.5\r\nv 0 1e0 0\r\ng na\xefve\r\nf 1 2 \\\r\n3\r\n"
    vertices, triangles = read(tmp_path, content)
    np.testing.assert_array_equal(vertices, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(triangles, [[0, 1, 2]])


def test_faces_may_come_before_their_vertices(tmp_path: Path) -> None:
    _, triangles = read(tmp_path, "f 1 2 3\n" + SQUARE)
    np.testing.assert_array_equal(triangles, [[0, 1, 2]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "found no vertices"),
        ("hello\nworld\n", "found no vertices"),
        (SQUARE, "found 4 vertices and no faces"),
        (SQUARE + "f 1 2\n", "line 5: found a face of 2 corners"),
        (SQUARE + "f 1 2 5\n", "line 5: found vertex 5 in a face, expected 1 to 4"),
        (SQUARE + "f 0 1 2\n", "line 5: found vertex 0"),
        (SQUARE + "f -5 1 2\n", "line 5: found vertex -5"),
        (SQUARE + "f a b c\n", "line 5: found 'a' in a face"),
        (SQUARE + "f 1.5 2 3\n", "line 5: found '1.5' in a face"),
        (SQUARE + "f 1 2 99999999999999999999\n", "line 5: found vertex 99999999999999999999"),
        ("v 0 0 nan\n", "line 1: found '0 0 nan', expected finite numbers"),
        ("v 0 0 0\nv 1e999 0 0\n", "line 2: .*finite"),
        ("v 0 0\n", "line 1: found a vertex of 2 numbers"),
        ("v 0 x 0\n", "line 1: found '0 x 0', expected x y z"),
        (b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR", "line 3: found binary data"),
        (bytes(range(256)) * 8, "binary data"),
    ],
)
def test_what_makes_no_sense_is_refused_with_its_line(tmp_path: Path, content: str | bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, content)
    assert str(caught.value).startswith(str(tmp_path / "a.obj"))


def test_missing_files_and_folders_are_named(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"b.obj: found no such file"):
        read_obj(tmp_path / "b.obj")
    with pytest.raises(ValueError, match="found a folder"):
        read_obj(tmp_path)


def test_random_bytes_never_do_more_than_raise_value_error(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    alphabet = np.frombuffer(b"vf 0123456789-/.e#\\\n\n\n", dtype=np.uint8)
    for _ in range(500):
        content = rng.choice(alphabet, size=200).tobytes()
        try:
            vertices, triangles = read(tmp_path, content)
        except ValueError:
            continue
        assert triangles.min() >= 0 and triangles.max() < len(vertices)
