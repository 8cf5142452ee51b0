# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import importlib
import sys

import broken_meshes as shapes
import numpy as np
import pytest

from followthrough import mesh


@pytest.mark.parametrize("way", ["sound", "unwelded seams", "doubled faces", "degenerate faces", "inside out"])
def test_the_surface_is_the_boundary(way: str) -> None:
    pytest.importorskip("tetgen")
    sound = shapes.sphere(10, 20)
    vertices, triangles = sound if way == "sound" else shapes.HARMLESS[way](sound)
    tet_mesh = mesh.tetrahedralize(vertices, triangles, method="tetgen")
    x = tet_mesh.vertices[tet_mesh.tets]
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    a, b, c = sound[0][sound[1]].transpose(1, 0, 2)
    assert (volumes > 0).all()
    assert volumes.sum() == pytest.approx(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)
    assert tet_mesh.parts == 1
    carried = mesh.interpolate(tet_mesh.vertices, tet_mesh.tets, tet_mesh.embedding_tets, tet_mesh.embedding_weights)
    assert np.abs(carried - vertices).max() < 1e-6
    values = mesh.SurfaceTransfer(vertices, triangles, tet_mesh)(vertices)
    on_surface = mesh.closest_points(tet_mesh.vertices, vertices, triangles)[2] < 1e-9
    assert np.allclose(values[on_surface], tet_mesh.vertices[on_surface], atol=1e-6)


def test_cell_size_bounds_the_tets() -> None:
    pytest.importorskip("tetgen")
    vertices, triangles = shapes.sphere(16, 32)
    coarse = mesh.tetrahedralize(vertices, triangles, method="tetgen")
    fine = mesh.tetrahedralize(vertices, triangles, method="tetgen", cell_size=0.1)
    assert len(fine.tets) > 2 * len(coarse.tets)


def test_surfaces_that_enclose_nothing_are_refused() -> None:
    pytest.importorskip("tetgen")
    vertices, triangles = shapes.sphere(10, 20)
    with pytest.raises(ValueError, match="3 open edges"):
        mesh.tetrahedralize(vertices, triangles[1:], method="tetgen")
    with pytest.raises(ValueError, match="edges"):
        mesh.tetrahedralize(*shapes.HARMLESS["a fin inside"](shapes.sphere()), method="tetgen")
    crossing = shapes.together((vertices, triangles), (vertices + 0.5, triangles))
    with pytest.raises(ValueError, match="self-intersect"):
        mesh.tetrahedralize(*crossing, method="tetgen")


def test_says_how_to_install_tetgen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tetgen", None)
    with pytest.raises(ImportError):
        importlib.import_module("tetgen")
    with pytest.raises(ValueError, match=r"pip install followthrough\[tetgen\]"):
        mesh.tetrahedralize(*shapes.box(), method="tetgen")
