# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequences of a surface instead of its volume, so that springs sit on the surface's own vertices ([ZS] has them there)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from followthrough import mesh
from followthrough.character import FloatArray, IntArray
from followthrough.npz_files import read_npz
from followthrough.sequences import Sequence


def on_surface(sequence: Sequence, embedding_tets: IntArray, embedding_weights: FloatArray) -> Sequence:
    """What a volume's motion does to the surface that it carries.

    Parameters
    ----------
    sequence
        Of the volume.
    embedding_tets : (v,) int, embedding_weights : (v, 4) float
        The tet that carries each vertex of the surface, and its weights there, as `mesh.tetrahedralize` gives them.

    Returns
    -------
    Sequence
        Of v vertices and no tets. A vertex is constrained where all corners that carry it are.
    """
    corners = sequence.tets[embedding_tets]

    def carried(values: FloatArray) -> FloatArray:
        return mesh.interpolate(values, sequence.tets, embedding_tets, embedding_weights)

    def frames(positions: FloatArray) -> FloatArray:
        return np.array([carried(frame) for frame in positions])

    density = sequence.density
    used = embedding_weights != 0.0
    return replace(
        sequence,
        rest_positions=carried(sequence.rest_positions),
        tets=np.zeros((0, 4), dtype=np.int32),
        constrained=(sequence.constrained[corners] | ~used).all(axis=1),
        youngs_modulus=np.exp(carried(np.log(sequence.youngs_modulus)[:, None])[:, 0]),
        density=density if np.ndim(density) == 0 else np.exp(carried(np.log(np.asarray(density))[:, None])[:, 0]),
        reference=frames(sequence.reference),
        dynamic=None if sequence.dynamic is None else frames(sequence.dynamic),
    )


def load_embedding(path: Path | str, sequence: Sequence) -> tuple[IntArray, FloatArray]:
    """Where a surface lies in a sequence's volume: from a file of `followthrough tetrahedralize`.

    Raises
    ------
    ValueError
        Where the file cannot be read, holds no embedding or is of another volume; names the file.
    """
    arrays = read_npz(path)
    missing = [name for name in ("tets", "embedding_tets", "embedding_weights") if name not in arrays]
    if missing:
        raise ValueError(f"{path}: found no {', '.join(missing)}, expected a file of followthrough tetrahedralize")
    if not np.array_equal(arrays["tets"], sequence.tets):
        raise ValueError(
            f"{path}: found {len(arrays['tets'])} tets that are not the sequence's {len(sequence.tets)}, expected the same volume"
        )
    carriers, weights = arrays["embedding_tets"], arrays["embedding_weights"]
    fits = carriers.ndim == 1 and weights.shape == (len(carriers), 4) and carriers.dtype.kind in "iu"
    if not fits or (len(carriers) and not (0 <= carriers.min() and carriers.max() < len(sequence.tets))):
        raise ValueError(f"{path}: found embedding_tets and embedding_weights that do not fit each other and the tets")
    return carriers.astype(np.int32), weights.astype(np.float64)
