# SPDX-License-Identifier: GPL-3.0-or-later
"""Inverses of small matrices, against NumPy's."""

import numpy as np
import pytest

from followthrough.affine import inverse_affine


def test_inverses_are_lapacks_up_to_round_off() -> None:
    random = np.random.default_rng(3)
    for scale in (1e-4, 1.0, 1e4):
        matrix = np.eye(4)
        matrix[:3] = scale * random.normal(size=(3, 4))
        np.testing.assert_allclose(inverse_affine(matrix), np.linalg.inv(matrix), rtol=1e-9, atol=1e-12)


def test_what_has_no_inverse_is_told() -> None:
    with pytest.raises(ZeroDivisionError):
        inverse_affine(np.diag([1.0, 0.0, 1.0, 1.0]))
