# SPDX-License-Identifier: GPL-3.0-or-later
"""Positions that every solver must refuse."""

from collections.abc import Iterator

import numpy as np
from elastic_scenes import Array


def bad_positions(good: Array) -> Iterator[Array]:
    """A vertex too few and too many, a flat array, and a single number that is not finite."""
    yield good[:-1]
    yield np.vstack([good, good[:1]])
    yield good[:, :2]
    for number in (np.nan, np.inf, -np.inf):
        broken = good.copy()
        broken[len(good) // 2, 1] = number
        yield broken
