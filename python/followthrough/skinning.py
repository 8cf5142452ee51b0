# SPDX-License-Identifier: GPL-3.0-or-later
"""Posing by bones as Blender's Armature modifier does it, its inverse, and bone weights from a surface to its volume.

All positions are in the mesh's object space. With the armature object's world matrix ``A``, the mesh object's ``O``, a
bone's ``matrix_local`` ``B`` and its pose bone's ``matrix`` ``P``, one frame is described by ::

    armature_matrix    = inverse(O) @ A
    bone_matrices      = armature_matrix @ P @ inverse(B) @ inverse(armature_matrix)
    bone_rest_matrices = B

A vertex's rest position is mapped to its posed position by an affine map, with dual quaternions too, so inverse
skinning is exact wherever the map can be inverted.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from followthrough import _core
from followthrough.character import FloatArray, IntArray, Skinning

#: Stands for "no bone" in a table of bone indices: that share of the weight follows the mesh object itself.
NO_BONE = -1

#: Vertices whose weights sum to no more than this are not moved by an armature.
LEAST_TOTAL_WEIGHT = float(np.float32(1e-4))

#: Weights of the volume below this share of a vertex's total are dropped.
NEGLIGIBLE_WEIGHT = 1e-4

#: Numbers that `transfer_bone_weights` holds at once.
_TRANSFER_BLOCK = 8_000_000


class Transfer(Protocol):
    """Carries values from a surface to its volume, for example `followthrough.mesh.SurfaceTransfer`."""

    def __call__(self, values: FloatArray) -> FloatArray:
        """Values (n, k) on the volume's vertices of values (v, k) on the surface's; sums of columns are kept."""


def pose_vertices(
    rest_positions: ArrayLike,
    bone_indices: ArrayLike,
    bone_weights: ArrayLike,
    bone_matrices: ArrayLike,
    skinning: Skinning = "linear",
    bone_rest_matrices: ArrayLike | None = None,
    armature_matrix: ArrayLike | None = None,
) -> FloatArray:
    """Move vertices as the bones do.

    Parameters
    ----------
    rest_positions : (n, 3) float64
        Object space.
    bone_indices : (n, k) int32
        Bones of every vertex in the order in which Blender stores its groups (with dual quaternions the order decides
        on which side of a half turn the blend goes). `NO_BONE` or anything else where the weight is 0; with a weight,
        `NO_BONE` holds the vertex to the mesh object.
    bone_weights : (n, k) float64
        As painted, 0 or more; they need not sum to one. Where they sum to `LEAST_TOTAL_WEIGHT` or less, the vertex
        does not move.
    bone_matrices : (b, 4, 4) float64
        From object space at rest to object space posed.
    skinning
        "dual-quaternion" is the Armature modifier's Preserve Volume.
    bone_rest_matrices : (b, 4, 4) float64, optional
        From a bone's own axes to the armature's space at rest. Dual quaternions need them to be exact where bones are
        sheared or scaled unevenly; linear blend does not use them.
    armature_matrix : (4, 4) float64, optional
        From the armature's space to the mesh's object space. Dual quaternions, which blend in the armature's space,
        need it to be exact where the mesh or armature object is scaled unevenly; linear blend does not use it.

    Returns
    -------
    (n, 3) float64, object space.

    Raises
    ------
    ValueError
        Where arrays do not fit each other or hold numbers that cannot be used, naming the array.
    """
    rest = _array("rest_positions", rest_positions, (None, 3))
    indices, weights = _weights(bone_indices, bone_weights, len(rest))
    bones = _bones(bone_matrices, bone_rest_matrices, armature_matrix)
    posed: FloatArray = _core.pose_vertices(rest, indices, weights, *bones, _dual_quaternion(skinning))
    return posed


def jacobians(
    rest_positions: ArrayLike,
    bone_indices: ArrayLike,
    bone_weights: ArrayLike,
    bone_matrices: ArrayLike,
    skinning: Skinning = "linear",
    bone_rest_matrices: ArrayLike | None = None,
    armature_matrix: ArrayLike | None = None,
) -> FloatArray:
    """Derivative of every vertex's posed position by its rest position.

    Parameters as in `pose_vertices`. The derivative does not depend on the vertex's own position.

    Returns
    -------
    (n, 3, 3) float64
    """
    rest = _array("rest_positions", rest_positions, (None, 3))
    indices, weights = _weights(bone_indices, bone_weights, len(rest))
    bones = _bones(bone_matrices, bone_rest_matrices, armature_matrix)
    flat: FloatArray = _core.skinning_jacobians(len(rest), indices, weights, *bones, _dual_quaternion(skinning))
    return flat.reshape(-1, 3, 3)


def inverse_skin(
    rest_positions: ArrayLike,
    bone_indices: ArrayLike,
    bone_weights: ArrayLike,
    bone_matrices: ArrayLike,
    displacements: ArrayLike,
    skinning: Skinning = "linear",
    minimum_stretch: float = 0.05,
    bone_rest_matrices: ArrayLike | None = None,
    armature_matrix: ArrayLike | None = None,
) -> tuple[FloatArray, FloatArray]:
    """What to add to the rest positions so that skinning shows these displacements.

    ``pose(rest + offsets) == pose(rest) + displacements - residuals``, up to rounding.

    Parameters
    ----------
    rest_positions, bone_indices, bone_weights, bone_matrices, skinning, bone_rest_matrices, armature_matrix
        As in `pose_vertices`.
    displacements : (n, 3) float64
        Of the posed vertices, object space.
    minimum_stretch
        Singular values of a vertex's Jacobian below this are raised to it, so that no offset is longer than its
        displacement divided by this.

    Returns
    -------
    offsets : (n, 3) float64
    residuals : (n, 3) float64
        The part of a displacement that its offset does not show, zero up to rounding where nothing was raised. Object
        space.
    """
    rest = _array("rest_positions", rest_positions, (None, 3))
    indices, weights = _weights(bone_indices, bone_weights, len(rest))
    bones = _bones(bone_matrices, bone_rest_matrices, armature_matrix)
    wanted = _array("displacements", displacements, (len(rest), 3))
    result: tuple[FloatArray, FloatArray] = _core.inverse_skin(
        indices, weights, *bones, wanted, _dual_quaternion(skinning), float(minimum_stretch)
    )
    return result


def invert_displacements(
    jacobians: ArrayLike, displacements: ArrayLike, minimum_stretch: float = 0.05
) -> tuple[FloatArray, FloatArray]:
    """`inverse_skin` for a mesh that anything may move, from its Jacobians.

    Parameters
    ----------
    jacobians : (n, 3, 3) float64
        Derivative of every vertex's deformed position by its undeformed position.
    displacements : (n, 3) float64
    minimum_stretch
        See `inverse_skin`.

    Returns
    -------
    offsets, residuals : (n, 3) float64
    """
    matrices = _array("jacobians", jacobians, (None, 3, 3))
    wanted = _array("displacements", displacements, (len(matrices), 3))
    result: tuple[FloatArray, FloatArray] = _core.invert_displacements(
        matrices.reshape(-1, 9), wanted, float(minimum_stretch)
    )
    return result


def transfer_bone_weights(
    transfer: Transfer, bone_indices: ArrayLike, bone_weights: ArrayLike, bone_count: int
) -> tuple[IntArray, FloatArray]:
    """Carry a surface's bone weights to its volume.

    Every surface vertex counts with weights that sum to one, as skinning uses them. Surface vertices that no bone
    moves count as wholly `NO_BONE`, so that the volume under them stays with the mesh object as they do.

    Parameters
    ----------
    transfer
        Carries columns of values from the surface to the volume; must keep values non-negative and their sum.
    bone_indices : (v, k) int32, bone_weights : (v, k) float64
        As in `pose_vertices`.
    bone_count
        Number of bones, b.

    Returns
    -------
    bone_indices : (n, j) int32, bone_weights : (n, j) float64
        Heaviest first, summing to one; weights below `NEGLIGIBLE_WEIGHT` are dropped. Unused places have index 0 and
        weight 0.
    """
    weights = _array("bone_weights", bone_weights, (None, None))
    indices, weights = _weights(bone_indices, weights, len(weights))
    count = len(weights)
    used = weights > 0.0
    if not np.isfinite(weights).all() or (weights < 0.0).any():
        raise ValueError(
            "bone_weights: found a number that is negative or not finite, expected finite numbers, 0 or more"
        )
    if (used & ((indices < NO_BONE) | (indices >= bone_count))).any():
        found = indices[used & ((indices < NO_BONE) | (indices >= bone_count))][0]
        raise ValueError(f"bone_indices: found index {found}, expected 0 to {bone_count - 1}, or {NO_BONE} for no bone")

    # Column 0 is "no bone", bone i is column i + 1.
    totals = weights.sum(axis=1)
    moved = totals > LEAST_TOTAL_WEIGHT
    vertices, places = np.nonzero(used & moved[:, None])
    rows = np.concatenate([vertices, np.flatnonzero(~moved)])
    columns = np.concatenate([indices[vertices, places] + 1, np.zeros(count - np.count_nonzero(moved), dtype=np.int64)])
    shares = np.concatenate([weights[vertices, places] / totals[vertices], np.ones(count - np.count_nonzero(moved))])

    present = np.unique(columns)
    position = np.searchsorted(present, columns)
    width = max(1, _TRANSFER_BLOCK // max(count, 1))
    found_rows, found_bones, found_weights = [], [], []
    carried = np.zeros(0)
    for start in range(0, len(present), width):
        chosen = (position >= start) & (position < start + width)
        columns_now = min(width, len(present) - start)
        places_now = rows[chosen] * columns_now + position[chosen] - start
        summed = np.bincount(places_now, weights=shares[chosen], minlength=count * columns_now).astype(np.float64)
        dense = summed.reshape(count, columns_now)
        block = np.asarray(transfer(dense), dtype=np.float64)
        carried = block.sum(axis=1) if start == 0 else carried + block.sum(axis=1)
        # The total is one, or will be: what is dropped here is dropped below as well.
        kept_rows, kept_columns = np.nonzero(block > 0.5 * NEGLIGIBLE_WEIGHT)
        found_rows.append(kept_rows)
        found_bones.append(present[start + kept_columns] - 1)
        found_weights.append(block[kept_rows, kept_columns])
    if not found_rows:
        return np.zeros((0, 1), dtype=np.int32), np.zeros((0, 1))
    return _padded_table(
        np.concatenate(found_rows), np.concatenate(found_bones), np.concatenate(found_weights), totals=carried
    )


def _padded_table(
    rows: IntArray, bones: IntArray, weights: FloatArray, totals: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Table (n, j) of weights given one by one, heaviest first, without those that are negligible in a row's total."""
    count = len(totals)
    kept = weights >= NEGLIGIBLE_WEIGHT * totals[rows]
    rows, bones, weights = rows[kept], bones[kept], weights[kept]
    order = np.lexsort((bones, -weights, rows))
    rows, bones, weights = rows[order], bones[order], weights[order]
    lengths = np.bincount(rows, minlength=count)
    places = np.arange(len(rows)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    shape = (count, max(1, int(lengths.max(initial=0))))
    indices = np.zeros(shape, dtype=np.int32)
    table = np.zeros(shape)
    indices[rows, places] = bones
    table[rows, places] = weights
    sums = table.sum(axis=1, keepdims=True)
    table /= np.where(sums > 0.0, sums, 1.0)
    return indices, table


def _array(name: str, values: ArrayLike, shape: tuple[int | None, ...]) -> FloatArray:
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.ndim != len(shape) or any(
        want is not None and have != want for have, want in zip(array.shape, shape, strict=True)
    ):
        expected = ", ".join("any" if want is None else str(want) for want in shape)
        raise ValueError(f"{name}: found shape {array.shape}, expected ({expected})")
    return array


def _weights(bone_indices: ArrayLike, bone_weights: ArrayLike, count: int) -> tuple[IntArray, FloatArray]:
    weights = _array("bone_weights", bone_weights, (count, None))
    indices = np.asarray(bone_indices)
    if indices.shape != weights.shape:
        raise ValueError(f"bone_indices: found shape {indices.shape}, expected {weights.shape} as bone_weights has")
    if indices.size and not np.issubdtype(indices.dtype, np.integer):
        raise ValueError(f"bone_indices: found numbers of type {indices.dtype}, expected integers")
    limits = np.iinfo(np.int32)
    return np.ascontiguousarray(np.clip(indices, limits.min, limits.max), dtype=np.int32), weights


def _bones(
    bone_matrices: ArrayLike, bone_rest_matrices: ArrayLike | None, armature_matrix: ArrayLike | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    matrices = _array("bone_matrices", bone_matrices, (None, 4, 4))
    rest = np.zeros((0, 4, 4))
    if bone_rest_matrices is not None:
        rest = _array("bone_rest_matrices", bone_rest_matrices, (len(matrices), 4, 4))
    armature = np.eye(4) if armature_matrix is None else _array("armature_matrix", armature_matrix, (4, 4))
    return matrices.reshape(-1, 16), rest.reshape(-1, 16), armature


def _dual_quaternion(skinning: str) -> bool:
    if skinning not in ("linear", "dual-quaternion"):
        raise ValueError(f"skinning: found {skinning!r}, expected 'linear' or 'dual-quaternion'")
    return skinning == "dual-quaternion"


__all__ = [
    "LEAST_TOTAL_WEIGHT",
    "NEGLIGIBLE_WEIGHT",
    "NO_BONE",
    "Transfer",
    "inverse_skin",
    "invert_displacements",
    "jacobians",
    "pose_vertices",
    "transfer_bone_weights",
]
