# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes to learn from and the motions of their bones: sound, varied, and what they promise to be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from followthrough import cli, mesh
from followthrough.datasets import Manifest, ShapesRecipe
from followthrough.datasets.bodies import LEAST_VOLUME
from followthrough.datasets.gestures import random_pose
from followthrough.datasets.shapes import FAMILIES
from followthrough.datasets.skeletons import Pose, Skeleton, rotation_matrices, skinned
from followthrough.datasets.surfaces import Surface, ellipsoid, slab, tube
from followthrough.datasets.varied import STIFFNESS_RANGE
from followthrough.sequences import Sequence


@pytest.fixture(scope="module")
def sequences() -> list[Sequence]:
    recipe = ShapesRecipe(1, frames=40)
    return [recipe.make(item) for item in recipe.items(3 * len(FAMILIES))]


def edge_of(sequence: Sequence) -> float:
    """Of a cube: its volume's cube root, from the free energy-less total; six tets a cube."""
    x = sequence.rest_positions[sequence.tets]
    volumes = np.linalg.det(x[:, 1:] - x[:, :1]) / 6
    return float(np.cbrt(6 * volumes.mean()))


def enclosed(surface: Surface) -> float:
    a, b, c = surface.vertices[surface.triangles].transpose(1, 0, 2)
    return float((a * np.cross(b, c)).sum() / 6)


def test_surfaces_are_closed_and_look_outside() -> None:
    assert enclosed(ellipsoid((5, 0, 1), (1, 2, 3), 60, 120)) == pytest.approx(8 * np.pi, rel=0.01)
    assert enclosed(ellipsoid((0, 0, 0), [[0, 2, 0], [0, 0, 3], [1, 0, 0]], 60, 120)) == pytest.approx(
        8 * np.pi, rel=0.01
    )
    assert enclosed(slab((1, 1, 1), (1, 2, 3), roundness=0.05)) == pytest.approx(48, rel=0.05)
    line = [[0, 0, 0], [5, 0, 0], [10, 0, 0]]
    assert enclosed(tube(line, [1, 1, 1], sides=60)) == pytest.approx((10 + 4 / 3) * np.pi, rel=0.02)
    for surface in (slab((0, 0, 0), (1, 2, 3)), tube(line, [[1, 2], [1, 1], [2, 1]], (0, 1, 0))):
        edges = np.sort(surface.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_a_flat_tube_is_wide_along_its_side() -> None:
    surface = tube([[0, 0, 0], [5, 0, 0], [10, 0, 0]], [[1, 3]] * 3, side=(0, 1, 0))
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), [12, 6, 2], atol=1e-12)


def test_rotation_vectors_turn_about_their_axis() -> None:
    vectors = np.array([[0, 0, np.pi / 2], [0, 0, 0], [1e-9, 0, 0], [0.3, -2, 0.7]])
    rotations = rotation_matrices(vectors)
    np.testing.assert_allclose(rotations[0] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotations[1:3], np.broadcast_to(np.eye(3), (2, 3, 3)), atol=2e-9)
    np.testing.assert_allclose(rotations[3] @ vectors[3], vectors[3], atol=1e-14)
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (4, 3, 3)), atol=1e-15
    )


def test_children_follow_their_parents() -> None:
    skeleton = Skeleton(np.array([[0.0, 0, 0], [5, 0, 0]]), np.array([[5.0, 0, 0], [10, 0, 0]]), (-1, 0))
    points = np.array([[2.0, 0, 0], [5, 0, 0], [10, 0, 0]])
    weights = np.array([[1.0, 0], [1, 0], [0, 1]])
    pose = Pose(np.array([[[0, 0, np.pi / 2], [0, np.pi / 2, 0]]]), np.ones((1, 3)))
    expected = [[[1, 3, 1], [1, 6, 1], [1, 6, -4]]]
    np.testing.assert_allclose(skinned(points, weights, skeleton, pose), expected, atol=1e-14)
    smooth = skeleton.weights(np.stack([np.linspace(0, 10, 101), np.zeros(101), np.ones(101)], axis=1))
    np.testing.assert_allclose(smooth.sum(axis=1), 1, atol=1e-14)
    assert (np.diff(smooth[10:91, 1]) > 0).all() and np.diff(smooth[:, 1]).max() < 0.2
    np.testing.assert_allclose(smooth[50], [0.5, 0.5])


def test_shapes_are_whole_and_have_free_and_held_vertices(sequences: list[Sequence]) -> None:
    for sequence in sequences:
        assert (mesh.connected_parts(sequence.tets, sequence.vertex_count) == 0).all()
        assert 100 < sequence.vertex_count < 2500
        assert sequence.constrained.sum() >= 8 and sequence.constrained.mean() <= 0.61
        x = sequence.rest_positions[sequence.tets]
        volumes = np.linalg.det(x[:, 1:] - x[:, :1])
        assert volumes.min() > 0.8 * LEAST_VOLUME * edge_of(sequence) ** 3
        np.testing.assert_array_equal(sequence.reference[0], sequence.rest_positions)


def test_some_rest_shapes_are_grids_and_others_are_not(sequences: list[Sequence]) -> None:
    regular = []
    for sequence in sequences:
        x = sequence.rest_positions[sequence.tets]
        volumes = np.linalg.det(x[:, 1:] - x[:, :1])
        regular.append(bool(np.ptp(volumes) < 1e-9 * volumes.max()))
    assert 4 < sum(regular) < len(regular) - 4


def test_materials_span_the_range_and_stay_in_it(sequences: list[Sequence]) -> None:
    low, high = STIFFNESS_RANGE
    stiffness = []
    for sequence in sequences:
        s = sequence.youngs_modulus * sequence.dt**2 / (sequence.density * edge_of(sequence) ** 2)
        assert 0.7 * low < s.min() and s.max() < 1.4 * high  # warped cubes are not quite as large
        stiffness.append((s.min(), s.max()))
    spans = np.array(stiffness)
    assert spans[:, 0].min() < 2 and spans[:, 1].max() > 60
    painted = spans[:, 1] > 1.01 * spans[:, 0]
    assert 5 < painted.sum() < len(painted) - 3
    assert len({sequence.dt for sequence in sequences}) >= 4
    assert any(np.ndim(sequence.density) for sequence in sequences)


def test_what_is_held_moves_hard_but_within_bounds(sequences: list[Sequence]) -> None:
    hardest = []
    for sequence in sequences:
        held = sequence.reference[:, sequence.constrained] / edge_of(sequence)
        hardest.append(np.linalg.norm(np.diff(held, 2, axis=0), axis=2).max())
        assert np.linalg.norm(np.diff(held, axis=0), axis=2).max() < 3
    assert max(hardest) < 1.5 and 0.15 < np.median(hardest)


def test_joints_turn_no_farther_than_joints_do() -> None:
    for seed in range(20):
        pose = random_pose(np.random.default_rng(seed), 200, 3)
        assert np.linalg.norm(pose.turns[:, 1:], axis=2).max() < 1.2
        assert (pose.turns[0] == 0).all() and (pose.translations[0] == 0).all()
        assert np.abs(pose.turns).max() > 0.1 and np.abs(pose.translations).max() > 0.1


def test_shapes_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["dataset", "shapes", "--motions=2", "--seed=4", "--frames=20", "--jobs=1", "-o", str(tmp_path / "set")]
    assert cli.main(command) == 0
    assert "2 sequences, 40 frames" in capsys.readouterr().out
    manifest = Manifest.load(tmp_path / "set")
    assert list(manifest.files) == ["shape-00000-slab.npz", "shape-00001-blob.npz"]
    for name, entry in manifest.files.items():
        sequence = Sequence.load(tmp_path / "set" / name)
        assert entry.worst_residual <= 1e-8 and sequence.dynamic is not None
        assert np.abs(sequence.dynamic - sequence.reference).max() > 1e-3 * edge_of(sequence)
    for bad in (["--stiffness-range", "5", "1"], ["--stiffness-range", "0", "1"], ["--stiffness-range", "nan", "1"]):
        assert cli.main([*command, *bad]) == 2
        assert "stiffness_range: found" in capsys.readouterr().err
