# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns what a caller gives into arrays that the core takes, or says by name what is wrong with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from followthrough.character import FloatArray, IntArray


def numbers(name: str, values: ArrayLike) -> FloatArray:
    """Real numbers of any shape."""
    array: NDArray[np.generic] = np.asarray(values)
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: found an array of {array.dtype}, expected real numbers")
    return np.asarray(array, dtype=np.float64, order="C")


def positions(name: str, values: ArrayLike) -> FloatArray:
    """Points or vectors, (n, 3)."""
    array = numbers(name, values)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: found shape {array.shape}, expected (n, 3)")
    return array


def vector(name: str, values: ArrayLike) -> FloatArray:
    """One number a vertex, (n,), whatever n is."""
    array = numbers(name, values)
    if array.ndim != 1:
        raise ValueError(f"{name}: found shape {array.shape}, expected (n,), one value a vertex")
    return array


def per_vertex(name: str, values: ArrayLike, count: int) -> FloatArray:
    """One number a vertex, (count,), made of such or of one for all."""
    array = numbers(name, values)
    if array.shape not in ((), (count,)):
        raise ValueError(f"{name}: found shape {array.shape}, expected () or ({count},), one value a vertex")
    return np.ascontiguousarray(np.broadcast_to(array, (count,)))


def optional_per_vertex(name: str, values: ArrayLike | None, count: int) -> FloatArray:
    """As `per_vertex`; None: an empty array."""
    return np.zeros(0) if values is None else per_vertex(name, values, count)


def vector3(name: str, values: ArrayLike) -> FloatArray:
    """One vector, (3,)."""
    array = numbers(name, values)
    if array.shape != (3,):
        raise ValueError(f"{name}: found shape {array.shape}, expected (3,)")
    return array


def mask(name: str, values: ArrayLike, count: int) -> NDArray[np.bool_]:
    """One truth value a vertex, (count,)."""
    array: NDArray[np.generic] = np.asarray(values)
    if array.shape != (count,) or array.dtype != np.bool_:
        raise ValueError(f"{name}: found shape {array.shape} of {array.dtype}, expected ({count},) of bool")
    return np.ascontiguousarray(array, dtype=np.bool_)


def tets(name: str, values: ArrayLike) -> IntArray:
    """Four vertices each, (m, 4) int32."""
    array: NDArray[np.generic] = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 4 or array.dtype.kind not in "iu":
        raise ValueError(f"{name}: found shape {array.shape} of {array.dtype}, expected (m, 4) integers")
    if array.size and not np.can_cast(np.min_scalar_type(array.max()), np.int32):
        raise ValueError(f"{name}: found index {array.max()}, expected one of a vertex")
    return np.ascontiguousarray(array, dtype=np.int32)
