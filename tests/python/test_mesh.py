# SPDX-License-Identifier: GPL-3.0-or-later
from __future__ import annotations

import hashlib

import broken_meshes as shapes
import numpy as np
import pytest

from followthrough import _core, mesh


def _volume(tet_mesh: mesh.TetMesh) -> float:
    x = tet_mesh.vertices[tet_mesh.tets]
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    assert (volumes > 0).all()
    return float(volumes.sum())


def _same(a: mesh.TetMesh, b: mesh.TetMesh) -> bool:
    return np.array_equal(a.vertices, b.vertices) and np.array_equal(a.tets, b.tets)


def test_box_is_filled_exactly() -> None:
    for cells in (1, 4, 25):
        tet_mesh = mesh.tetrahedralize(*shapes.box(), cells=cells)
        assert tet_mesh.cells == cells**3
        assert len(tet_mesh.vertices) == (cells + 1) ** 3
        assert len(tet_mesh.tets) == 6 * cells**3
        assert _volume(tet_mesh) == pytest.approx(1.0)
        assert tet_mesh.parts == 1
        assert tet_mesh.cell_size == pytest.approx(1 / cells)
    assert _volume(mesh.tetrahedralize(*shapes.box((1, 2, 3)), cells=6)) == pytest.approx(6.0)


def test_fine_sphere_has_the_published_counts() -> None:
    tet_mesh = mesh.tetrahedralize(*shapes.sphere(60, 120), cell_size=0.2)
    assert (tet_mesh.cells, len(tet_mesh.vertices), len(tet_mesh.tets)) == (720, 1015, 4320)
    cells = np.stack(np.meshgrid(*[np.arange(-5, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    nearest = 0.2 * np.where(cells < 0, -cells - 1, cells)
    cells = cells[np.linalg.norm(nearest, axis=1) < 0.99]
    offsets = "000 100 010 001 100 010 001 101 010 001 101 011 100 110 010 101 110 101 111 011 110 010 101 011".split()
    corners = cells[:, None] + np.array([[int(d) for d in offset] for offset in offsets])
    vertices, tets = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    assert np.allclose(tet_mesh.vertices, 0.2 * vertices, atol=1e-12)
    assert np.array_equal(tet_mesh.tets, tets.reshape(-1, 4))


def test_kept_are_the_cells_that_the_surface_touches_or_encloses() -> None:
    vertices, triangles = shapes.together(shapes.sphere(), shapes.sphere(centre=(1.2, 0.3, 0.4)))
    tet_mesh = mesh.tetrahedralize(vertices, triangles, cells=17)
    corners = tet_mesh.vertices[tet_mesh.tets.reshape(-1, 24)]
    low = corners.min(axis=1)
    centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    found = {tuple(cell) for cell in np.round((low - centre) / tet_mesh.cell_size + 8.5).astype(int)}
    grid = np.stack(np.meshgrid(*[np.arange(17)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    inside = mesh.winding_numbers(centre + tet_mesh.cell_size * (grid - 8.0), vertices, triangles) > 0.5
    enclosed = {tuple(cell) for cell in grid[inside]}
    # Many points of the surface: all their cells must be there, and nothing that is neither touched nor enclosed.
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], size=(len(triangles), 40))
    samples = np.einsum("tsk,tkd->tsd", weights, vertices[triangles]).reshape(-1, 3)
    touched = {tuple(cell) for cell in np.floor((samples - centre) / tet_mesh.cell_size + 8.5 - 1e-12).astype(int)}
    assert enclosed | touched <= found
    assert len(found - enclosed - touched) < 0.02 * len(found)


@pytest.mark.parametrize("split", [False, True])
@pytest.mark.parametrize("way", shapes.HARMLESS)
def test_broken_surface_gives_the_sound_volume(way: str, split: bool) -> None:
    sound = mesh.tetrahedralize(*shapes.sphere(), cells=12)
    vertices, triangles = shapes.HARMLESS[way](shapes.sphere())
    tet_mesh = mesh.tetrahedralize(vertices, triangles, cells=12, split_parts=split)
    assert _same(tet_mesh, sound)
    carried = mesh.interpolate(tet_mesh.vertices, tet_mesh.tets, tet_mesh.embedding_tets, tet_mesh.embedding_weights)
    assert np.allclose(carried, vertices, atol=1e-12)


@pytest.mark.parametrize("split", [False, True])
def test_open_surface_keeps_its_inside(split: bool) -> None:
    vertices, triangles = shapes.sphere()
    sound = mesh.tetrahedralize(vertices, triangles, cells=12)
    hole = triangles[vertices[triangles].mean(axis=1)[:, 2] < 0.8]
    tet_mesh = mesh.tetrahedralize(vertices, hole, cells=12, split_parts=split)
    assert 0.85 * sound.cells < tet_mesh.cells <= sound.cells
    assert tet_mesh.parts == 1


@pytest.mark.parametrize("split", [False, True])
def test_many_parts(split: bool) -> None:
    left, right, crossing = shapes.sphere(), shapes.sphere(centre=(3, 0, 0)), shapes.sphere(centre=(0.9, 0, 0))
    apart = mesh.tetrahedralize(*shapes.together(left, shapes.inside_out(right)), cells=20, split_parts=split)
    assert apart.parts == 2
    assert 2 * 4 / 3 * np.pi < _volume(apart) < 2 * 4 / 3 * np.pi * (1 + 2 * apart.cell_size) ** 3
    plain = mesh.tetrahedralize(*shapes.together(left, crossing), cells=20)
    assert plain.parts == 1
    for other in (crossing, shapes.inside_out(crossing)):
        tet_mesh = mesh.tetrahedralize(*shapes.together(left, other), cells=20, split_parts=split)
        assert tet_mesh.parts == 1
        assert _volume(tet_mesh) == pytest.approx(_volume(plain), rel=0.02 if split else 1e-12)


def test_random_triangles_do_no_harm() -> None:
    random = np.random.default_rng(1)
    for _ in range(5):
        vertices = random.normal(size=(300, 3))
        triangles = random.integers(0, 300, size=(200, 3)).astype(np.int32)
        for split in (False, True):
            tet_mesh = mesh.tetrahedralize(vertices, triangles, cells=9, split_parts=split)
            assert _volume(tet_mesh) > 0
            carried = mesh.interpolate(
                tet_mesh.vertices, tet_mesh.tets, tet_mesh.embedding_tets, tet_mesh.embedding_weights
            )
            assert np.allclose(carried, vertices, atol=1e-9)
            transfer = mesh.SurfaceTransfer(vertices, triangles, tet_mesh)
            assert np.allclose(transfer(np.ones((300, 1))), 1.0)


def test_legs_are_not_glued_when_parts_are_split() -> None:
    vertices, triangles = shapes.forked()
    left = np.arange(len(vertices)) < len(vertices) // 2
    low = vertices[:, 2] < -0.8
    shared = {}
    for split in (False, True):
        tet_mesh = mesh.tetrahedralize(vertices, triangles, cells=12, split_parts=split)
        corners = tet_mesh.tets[tet_mesh.embedding_tets]
        shared[split] = len(np.intersect1d(corners[left & low], corners[~left & low]))
        assert tet_mesh.parts == 1
    assert shared[False] > 10
    assert shared[True] == 0
    transfer = mesh.SurfaceTransfer(vertices, triangles, tet_mesh)
    carried = mesh.interpolate(
        transfer(left[:, None].astype(float)), tet_mesh.tets, tet_mesh.embedding_tets, tet_mesh.embedding_weights
    )
    assert np.allclose(carried[low, 0], left[low], atol=0.02)


def test_embedding_reproduces_affine_motions() -> None:
    random = np.random.default_rng(2)
    tet_mesh = mesh.tetrahedralize(*shapes.sphere(), cells=8)
    points = random.uniform(-1.5, 1.5, size=(300, 3))
    tets, weights = mesh.embed(points, tet_mesh.vertices, tet_mesh.tets)
    linear, shift = random.normal(size=(3, 3)), random.normal(size=3)
    carried = mesh.interpolate(tet_mesh.vertices @ linear + shift, tet_mesh.tets, tets, weights)
    assert np.abs(carried - points @ linear - shift).max() < 1e-12
    assert np.abs(weights.sum(axis=1) - 1).max() < 1e-13


def test_transfer_keeps_weights_weights() -> None:
    vertices, triangles = shapes.sphere()
    tet_mesh = mesh.tetrahedralize(vertices, triangles, cells=10)
    weights = np.random.default_rng(3).dirichlet(np.full(6, 0.1), size=len(vertices))
    carried = mesh.SurfaceTransfer(vertices, triangles, tet_mesh)(weights)
    assert carried.shape == (len(tet_mesh.vertices), 6)
    assert carried.min() >= 0
    assert np.abs(carried.sum(axis=1) - 1).max() < 1e-12


def test_follower_moves_rigidly_in_metres() -> None:
    vertices, triangles = shapes.sphere()
    stretch = np.array([[2.0, 0.3, 0], [0.3, 1.0, 0], [0, 0, 0.5]])
    tet_mesh = mesh.tetrahedralize(vertices @ stretch.T, triangles, cells=10)
    follower = mesh.SurfaceFollower(vertices, triangles, tet_mesh, stretch)
    to_object = np.linalg.inv(stretch).T
    assert np.abs(follower(vertices) - tet_mesh.vertices @ to_object).max() < 1e-9
    turn = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    moved = (vertices @ stretch.T @ turn.T + [1, 2, 3]) @ to_object
    expected = (tet_mesh.vertices @ turn.T + [1, 2, 3]) @ to_object
    assert np.abs(follower(moved) - expected).max() < 1e-9


def test_results_do_not_depend_on_threads() -> None:
    vertices, triangles = shapes.forked()
    before = _core.threads()
    hashes = set()
    try:
        for threads in (1, 2, 4):
            _core.set_threads(threads)
            tet_mesh = mesh.tetrahedralize(vertices, triangles[50:], cells=15, split_parts=True)
            values = mesh.SurfaceTransfer(vertices, triangles, tet_mesh)(vertices)
            moved = mesh.SurfaceFollower(vertices, triangles, tet_mesh, np.eye(3))(vertices * [1, 2, 1])
            closest = mesh.closest_points(tet_mesh.vertices, vertices, triangles)
            arrays = (tet_mesh.vertices, tet_mesh.tets, tet_mesh.embedding_tets, tet_mesh.embedding_weights)
            digest = hashlib.sha256()
            for array in (*arrays, values, moved, *closest):
                digest.update(np.ascontiguousarray(array).tobytes())
            hashes.add(digest.hexdigest())
    finally:
        _core.set_threads(before)
    assert len(hashes) == 1


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("vertices", {"vertices": np.zeros((0, 3))}),
        ("vertices", {"vertices": np.full((8, 3), np.nan)}),
        ("vertices", {"vertices": np.ones((8, 3))}),
        ("vertices", {"vertices": np.zeros((8, 2))}),
        ("triangles", {"triangles": np.zeros((0, 3), dtype=int)}),
        ("triangles", {"triangles": np.array([[0, 1, 8]])}),
        ("triangles", {"triangles": np.array([[0, -1, 2]])}),
        ("triangles", {"triangles": np.array([[0, 1, 2**40]])}),
        ("triangles", {"triangles": np.array([[0.5, 1, 2]])}),
        ("triangles", {"triangles": np.array([[1, 1, 2]])}),
        ("cells", {"cells": 0}),
        ("cells", {"cells": 1000}),
        ("cell_size", {"cell_size": 0.0}),
        ("cell_size", {"cell_size": -1.0}),
        ("cell_size", {"cell_size": np.nan}),
        ("cell_size", {"cell_size": np.inf}),
        ("cell_size", {"cell_size": 1e-5}),
        ("method", {"method": "marching"}),
    ],
)
def test_bad_input_is_refused_by_name(name: str, change: dict[str, object]) -> None:
    vertices, triangles = shapes.box()
    arguments = {"vertices": vertices, "triangles": triangles} | change
    with pytest.raises(ValueError, match=f"^{name}: "):
        mesh.tetrahedralize(**arguments)  # type: ignore[arg-type]
