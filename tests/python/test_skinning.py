# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties of posing, its derivative and its inverse, and of bone weights carried to a volume."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough import skinning
from followthrough.character import FloatArray, IntArray, Skinning

METHODS: tuple[Skinning, ...] = ("linear", "dual-quaternion")
BONES = 6


def rotation(rng: np.random.Generator, most: float = 1.2) -> FloatArray:
    """By Rodrigues' formula, about a random axis."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    cross = np.cross(np.eye(3), axis)
    angle = rng.uniform(-most, most)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def affine(linear: FloatArray, translation: FloatArray) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, translation
    return matrix


class Skin:
    """Random vertices on random bones."""

    def __init__(self, seed: int = 0, count: int = 200, scaled: bool = True) -> None:
        rng = np.random.default_rng(seed)
        self.rng = rng
        self.rest = rng.normal(size=(count, 3))
        self.indices: IntArray = rng.integers(0, BONES, (count, 4)).astype(np.int32)
        self.weights = rng.uniform(0, 1, (count, 4)) * (rng.uniform(size=(count, 4)) < 0.7)
        self.matrices = np.array(
            [
                affine(rotation(rng) @ np.diag(rng.uniform(0.6, 1.5, 3) if scaled else np.ones(3)), rng.normal(size=3))
                for _ in range(BONES)
            ]
        )
        self.rest_matrices = np.array([affine(rotation(rng, 3.0), rng.normal(size=3)) for _ in range(BONES)])
        self.armature = affine(rotation(rng) @ np.diag([0.5, 1.4, 2.0]), rng.normal(size=3))

    def pose(self, method: Skinning, rest: FloatArray | None = None) -> FloatArray:
        return skinning.pose_vertices(
            self.rest if rest is None else rest,
            self.indices,
            self.weights,
            self.matrices,
            method,
            self.rest_matrices,
            self.armature,
        )

    def unmoved(self) -> NDArray[np.bool_]:
        return self.weights.sum(axis=1) <= 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_one_motion_of_all_bones_moves_everything_so(method: Skinning) -> None:
    skin = Skin()
    motion = affine(rotation(skin.rng, 3.0), np.array([1.0, -2.0, 3.0]))
    skin.matrices = np.repeat(motion[None], BONES, axis=0)
    skin.armature = affine(2.5 * rotation(skin.rng), np.array([3.0, 0.0, 1.0]))
    expected = skin.rest @ motion[:3, :3].T + motion[:3, 3]
    expected[skin.unmoved()] = skin.rest[skin.unmoved()]
    np.testing.assert_allclose(skin.pose(method), expected, atol=1e-13)


@pytest.mark.parametrize("method", METHODS)
def test_a_vertex_on_one_bone_goes_where_its_matrix_says(method: Skinning) -> None:
    skin = Skin()
    skin.weights[:, 1:] = 0.0
    skin.weights[:, 0] = skin.rng.uniform(0.01, 2.0, len(skin.rest))
    matrices = skin.matrices[skin.indices[:, 0]]
    expected = np.einsum("nij,nj->ni", matrices[:, :3, :3], skin.rest) + matrices[:, :3, 3]
    np.testing.assert_allclose(skin.pose(method), expected, atol=1e-13)


@pytest.mark.parametrize("method", METHODS)
def test_a_turn_and_an_even_scale_of_the_armature_object_make_no_difference(method: Skinning) -> None:
    skin = Skin()
    pose = (skin.rest, skin.indices, skin.weights, skin.matrices, method)
    turn = rotation(skin.rng)
    axes = np.array([rotation(skin.rng) for _ in range(BONES)])
    results = []
    for to_object in (np.eye(3), 3.0 * turn):
        rest = np.array(
            [
                affine(np.linalg.inv(to_object) @ (axis * np.cbrt(np.linalg.det(to_object))), np.zeros(3))
                for axis in axes
            ]
        )
        results.append(skinning.pose_vertices(*pose, rest, affine(to_object, np.ones(3))))
    np.testing.assert_allclose(results[0], results[1], atol=1e-12)
    # Unevenly scaled, the blend takes place in another space; linear blend does not mind.
    uneven = skinning.pose_vertices(*pose, rest, affine(np.diag([1.0, 1.0, 4.0]), np.ones(3)))
    assert np.allclose(uneven, results[0], atol=1e-12) == (method == "linear")


def test_dual_quaternions_keep_a_twisted_ring_round_where_linear_blend_shrinks_it() -> None:
    angles = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.zeros(12), np.sin(angles)])
    half_turn = affine(np.diag([-1.0, 1.0, -1.0]) @ np.eye(3), np.zeros(3))
    quarter = affine(np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.zeros(3))
    for turned, shrunk in ((quarter, np.sqrt(0.5)), (half_turn, 0.0)):
        table = (ring, np.tile([0, 1], (12, 1)), np.full((12, 2), 0.5), np.array([np.eye(4), turned]))
        np.testing.assert_allclose(np.linalg.norm(skinning.pose_vertices(*table, "linear"), axis=1), shrunk, atol=1e-12)
        np.testing.assert_allclose(
            np.linalg.norm(skinning.pose_vertices(*table, "dual-quaternion"), axis=1), 1, atol=1e-12
        )


@pytest.mark.parametrize("method", METHODS)
def test_weights_need_not_sum_to_one(method: Skinning) -> None:
    skin = Skin()
    posed = skin.pose(method)
    skin.weights *= skin.rng.uniform(0.5, 20.0, (len(skin.rest), 1))
    np.testing.assert_allclose(skin.pose(method), posed, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_vertices_without_weights_stay(method: Skinning) -> None:
    skin = Skin()
    skin.weights[0] = 0.0
    skin.weights[1] = [9e-5, 0, 0, 0]
    skin.weights[2] = [1.1e-4, 0, 0, 0]
    skin.weights[3], skin.indices[3] = [0.3, 0.2, 0, 0], skinning.NO_BONE
    moved = np.abs(skin.pose(method) - skin.rest).max(axis=1) > 1e-12
    assert list(moved[:4]) == [False, False, True, False]


@pytest.mark.parametrize("method", METHODS)
def test_a_share_of_no_bone_is_a_bone_that_never_moves(method: Skinning) -> None:
    skin = Skin()
    never = np.concatenate([skin.matrices, np.eye(4)[None]])
    rest = np.concatenate([skin.rest_matrices, np.eye(4)[None]])
    as_bone, as_none = skin.indices.copy(), skin.indices.copy()
    as_bone[:, 2], as_none[:, 2] = BONES, skinning.NO_BONE
    np.testing.assert_allclose(
        skinning.pose_vertices(skin.rest, as_none, skin.weights, never, method, rest, skin.armature),
        skinning.pose_vertices(skin.rest, as_bone, skin.weights, never, method, rest, skin.armature),
        atol=1e-13,
    )


@pytest.mark.parametrize("method", METHODS)
def test_jacobians_are_the_slopes_of_posing(method: Skinning) -> None:
    skin = Skin()
    derivative = skinning.jacobians(
        skin.rest, skin.indices, skin.weights, skin.matrices, method, skin.rest_matrices, skin.armature
    )
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 0.5  # exact at any step: the map is affine
        slope = skin.pose(method, skin.rest + step) - skin.pose(method, skin.rest - step)
        np.testing.assert_allclose(derivative[:, :, axis], slope, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_offsets_show_the_displacement(method: Skinning) -> None:
    skin = Skin()
    displacements = skin.rng.normal(size=skin.rest.shape)
    offsets, residuals = skinning.inverse_skin(
        skin.rest,
        skin.indices,
        skin.weights,
        skin.matrices,
        displacements,
        method,
        1e-6,
        skin.rest_matrices,
        skin.armature,
    )
    shown = skin.pose(method, skin.rest + offsets) - skin.pose(method)
    np.testing.assert_allclose(shown, displacements, atol=1e-9)
    assert np.abs(residuals).max() <= 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_where_the_skin_is_flattened_offsets_stay_bounded_and_the_rest_is_reported(method: Skinning) -> None:
    skin = Skin(scaled=False)
    for bone in range(BONES):
        skin.matrices[bone, :3, :3] = skin.matrices[bone, :3, :3] @ np.diag([1.0, 1e-4 * bone, 1.0])
    displacements = skin.rng.normal(size=skin.rest.shape)
    arguments = (skin.rest, skin.indices, skin.weights, skin.matrices)
    offsets, residuals = skinning.inverse_skin(
        *arguments, displacements, method, 0.05, skin.rest_matrices, skin.armature
    )
    lengths = np.linalg.norm(displacements, axis=1)
    assert (np.linalg.norm(offsets, axis=1) <= lengths / 0.05 * (1 + 1e-9)).all()
    assert (np.linalg.norm(residuals, axis=1) <= lengths * (1 + 1e-9)).all()
    shown = skin.pose(method, skin.rest + offsets) - skin.pose(method)
    np.testing.assert_allclose(shown, displacements - residuals, atol=1e-11)
    flattened = np.linalg.norm(residuals, axis=1) > 1e-3 * lengths
    smallest = np.linalg.svd(
        skinning.jacobians(*arguments, method, skin.rest_matrices, skin.armature), compute_uv=False
    )[:, 2]
    assert flattened.any() and not flattened.all()
    assert (smallest[flattened] < 0.05).all()
    assert np.abs(residuals[smallest > 0.05]).max() < 1e-12


def test_singular_values_are_clamped_one_by_one() -> None:
    rng = np.random.default_rng(1)
    left, right = rotation(rng, 3.0), rotation(rng, 3.0)
    stretches = np.array([[2.0, 1.0, 0.5], [2.0, 1.0, 0.01], [1.0, 0.02, -0.01], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    jacobians = left @ (stretches[:, :, None] * np.eye(3)) @ right.T
    displacements = np.repeat((left @ np.ones(3))[None], len(stretches), axis=0)
    offsets, residuals = skinning.invert_displacements(jacobians, displacements, 0.05)
    clamped = np.maximum(np.abs(stretches), 0.05)
    # In the axes of the stretches; where one is zero its direction's sign is anybody's.
    np.testing.assert_allclose(np.abs(offsets @ right)[:4, 0], (1 / clamped)[:4, 0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(offsets, axis=1), np.linalg.norm(1 / clamped, axis=1), rtol=1e-12)
    np.testing.assert_allclose(residuals @ left, 1 - np.abs(stretches) / clamped, atol=1e-12)


def test_the_closed_form_and_the_decomposition_agree_where_one_takes_over() -> None:
    rng = np.random.default_rng(2)
    jacobians = rng.normal(size=(2000, 3, 3)) * rng.uniform(0.01, 10, (2000, 1, 1))
    displacements = rng.normal(size=(2000, 3))
    u, s, vt = np.linalg.svd(jacobians)
    for minimum in (1e-6, 0.05, 0.5, 5.0):
        offsets, residuals = skinning.invert_displacements(jacobians, displacements, minimum)
        expected = np.einsum("nji,nj->ni", vt, np.einsum("nji,nj->ni", u, displacements) / np.maximum(s, minimum))
        np.testing.assert_allclose(offsets, expected, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(residuals, displacements - np.einsum("nij,nj->ni", jacobians, offsets), atol=1e-9)


class Mixing:
    """Stands in for a surface transfer: volume vertices average surface vertices."""

    def __init__(self, rng: np.random.Generator, targets: int, sources: int) -> None:
        self.matrix = rng.uniform(size=(targets, sources)) ** 8
        self.matrix /= self.matrix.sum(axis=1, keepdims=True)
        self.calls = 0

    def __call__(self, values: FloatArray) -> FloatArray:
        self.calls += 1
        return self.matrix @ values


def dense(indices: IntArray, weights: FloatArray, bones: int) -> FloatArray:
    table = np.zeros((len(indices), bones + 1))
    np.add.at(table, (np.arange(len(indices))[:, None], np.where(indices < 0, bones, indices)), weights)
    return table


@pytest.mark.parametrize("block", [8_000_000, 300])
def test_bone_weights_reach_the_volume_normalised(monkeypatch: pytest.MonkeyPatch, block: int) -> None:
    monkeypatch.setattr(skinning, "_TRANSFER_BLOCK", block)
    skin = Skin(count=100)
    skin.weights[:10] = 0.0
    skin.weights[10] = [5e-5, 0, 0, 0]
    skin.weights[11:30] *= 7.0
    mixing = Mixing(skin.rng, 50, 100)
    indices, weights = skinning.transfer_bone_weights(mixing, skin.indices, skin.weights, BONES)
    assert (mixing.calls > 1) == (block == 300)
    assert indices.dtype == np.int32 and indices.shape == weights.shape
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-14)
    assert (np.diff(weights, axis=1) <= 0).all()
    surface = dense(skin.indices, skin.weights, BONES)
    surface[skin.unmoved()] = np.eye(BONES + 1)[BONES]
    surface /= surface.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(dense(indices, weights, BONES), mixing.matrix @ surface, atol=1e-3)
    assert weights[weights > 0].min() >= skinning.NEGLIGIBLE_WEIGHT


def test_the_volume_under_skin_that_no_bone_moves_stays_with_the_object() -> None:
    rng = np.random.default_rng(0)
    indices, weights = skinning.transfer_bone_weights(
        Mixing(rng, 4, 20), np.zeros((20, 2), dtype=np.int32), np.zeros((20, 2)), BONES
    )
    rest = rng.normal(size=(4, 3))
    np.testing.assert_array_equal(
        skinning.pose_vertices(rest, indices, weights, Skin().matrices, "dual-quaternion"), rest
    )


def test_negligible_weights_are_dropped() -> None:
    table = np.array([[0.99995, 0.00005], [0.5, 0.5]])
    indices, weights = skinning.transfer_bone_weights(lambda values: values, np.tile([0, 1], (2, 1)), table, 2)
    np.testing.assert_array_equal(weights, [[1.0, 0.0], [0.5, 0.5]])
    np.testing.assert_array_equal(indices, [[0, 0], [0, 1]])


def test_bad_input_is_named() -> None:
    skin = Skin(count=5)
    good = {
        "rest_positions": skin.rest,
        "bone_indices": skin.indices,
        "bone_weights": skin.weights + 0.1,
        "bone_matrices": skin.matrices,
        "bone_rest_matrices": skin.rest_matrices,
        "skinning": "dual-quaternion",
    }

    def refused(message: str, **bad: object) -> None:
        with pytest.raises(ValueError, match=message):
            skinning.pose_vertices(**(good | bad))  # type: ignore[arg-type]

    def with_entry(name: str, value: float) -> FloatArray:
        array = np.array(good[name])
        array[(3, *[0] * (array.ndim - 1))] = value
        return array

    skinning.pose_vertices(**good)  # type: ignore[arg-type]
    refused(r"rest_positions: found shape \(3,\), expected \(any, 3\)", rest_positions=np.zeros(3))
    refused("rest_positions: row 3 holds", rest_positions=with_entry("rest_positions", np.nan))
    refused(r"bone_weights: found shape \(4, 4\), expected \(5, any\)", bone_weights=skin.weights[:4])
    refused("bone_weights: row 3 holds -0.5", bone_weights=with_entry("bone_weights", -0.5))
    refused("bone_weights: row 3 holds", bone_weights=with_entry("bone_weights", np.inf))
    refused(r"bone_indices: found shape \(5, 3\), expected \(5, 4\)", bone_indices=skin.indices[:, :3])
    refused("bone_indices: row 3 holds index 6, expected 0 to 5", bone_indices=with_entry("bone_indices", 6))
    refused("bone_indices: row 3 holds index -2, expected 0 to 5", bone_indices=with_entry("bone_indices", -2))
    refused(
        "bone_indices: row 0 holds index 2147483647",
        bone_indices=with_entry("bone_indices", 0).astype(np.int64) + 2**40,
    )
    refused("bone_indices: found numbers of type float64", bone_indices=skin.indices * 1.0)
    refused(r"bone_matrices: found shape \(6, 3, 3\)", bone_matrices=skin.matrices[:, :3, :3])
    refused("bone_matrices: row 3 holds", bone_matrices=with_entry("bone_matrices", np.nan))
    refused(
        "bone_matrices: matrix 1 is not affine",
        bone_matrices=skin.matrices + np.eye(4)[3] * np.array([0, 1, 0, 0, 0, 0])[:, None, None],
    )
    refused(r"bone_rest_matrices: found shape \(5, 4, 4\)", bone_rest_matrices=skin.rest_matrices[:5])
    refused(
        "bone_rest_matrices: matrix 0 is not a rotation",
        bone_rest_matrices=np.diag([2.0, 1, 1, 1]) @ skin.rest_matrices,
    )
    refused("armature_matrix: is singular", armature_matrix=np.diag([1.0, 0, 1, 1]))
    refused("skinning: found 'cubic'", skinning="cubic")
    with pytest.raises(ValueError, match="minimum_stretch: found 0"):
        skinning.invert_displacements(np.eye(3)[None], np.zeros((1, 3)), 0.0)
    with pytest.raises(ValueError, match="displacements: row 0 holds"):
        skinning.invert_displacements(np.eye(3)[None], np.full((1, 3), np.nan))
    with pytest.raises(ValueError, match="jacobians: row 0 holds"):
        skinning.invert_displacements(np.full((1, 3, 3), np.inf), np.zeros((1, 3)))
    with pytest.raises(ValueError, match="bone_indices: found index 9"):
        skinning.transfer_bone_weights(lambda values: values, np.array([[9]]), np.array([[1.0]]), 2)


def test_nothing_to_pose_is_fine() -> None:
    empty = (np.zeros((0, 3)), np.zeros((0, 0), dtype=np.int32), np.zeros((0, 0)), np.zeros((0, 4, 4)))
    for method in METHODS:
        assert skinning.pose_vertices(*empty, method).shape == (0, 3)
        assert skinning.jacobians(*empty, method).shape == (0, 3, 3)
    offsets, residuals = skinning.inverse_skin(*empty, np.zeros((0, 3)))
    assert offsets.shape == residuals.shape == (0, 3)
