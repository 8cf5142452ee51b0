# SPDX-License-Identifier: GPL-3.0-or-later
"""Inverses of single small matrices. Not LAPACK's: its threads would go on spinning beside Blender's for the whole next frame."""

from __future__ import annotations

import numpy as np

from followthrough.character import FloatArray


def inverse_affine(matrix: FloatArray) -> FloatArray:
    """Inverse of a (4, 4) matrix whose last row is 0 0 0 1.

    Raises
    ------
    ZeroDivisionError
        Where it has none.
    """
    inverse = np.eye(4)
    inverse[:3, :3] = _inverse_linear(matrix[:3, :3])
    inverse[:3, 3] = -inverse[:3, :3] @ matrix[:3, 3]
    return inverse


def determinant(matrix: FloatArray) -> float:
    """Of a (3, 3) matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    found: float = a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g)
    return found


def _inverse_linear(matrix: FloatArray) -> FloatArray:
    """Inverse of a (3, 3) matrix, by cofactors."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    scale = 1.0 / (a * first + b * second + c * third)
    rows = [
        [first, c * h - b * i, b * f - c * e],
        [second, a * i - c * g, c * d - a * f],
        [third, b * g - a * h, a * e - b * d],
    ]
    inverse: FloatArray = np.array(rows) * scale
    return inverse
