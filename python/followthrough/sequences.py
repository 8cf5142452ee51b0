# SPDX-License-Identifier: GPL-3.0-or-later
"""Sequence files: a volume, its material, and its motion frame by frame, in one .npz."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray, IntArray
from followthrough.npz_files import read_npz, write_npz


@dataclass(frozen=True, eq=False)
class Sequence:
    """A volume in motion. Everything is checked when it is made.

    Parameters
    ----------
    rest_positions : (n, 3) float64
        Vertices at rest, m.
    tets : (m, 4) int32
        Their tetrahedra.
    constrained : (n,) bool
        Vertices that follow the reference exactly.
    youngs_modulus : (n,) float64
        Stiffness of the material at the vertices, Pa.
    dt : float
        Seconds a frame.
    reference : (F, n, 3) float64
        Positions without secondary motion, m.
    density : float or (n,) float64
        kg/m³.
    poisson_ratio : float
        -1 to 0.5, both excluded.
    compression_resistance : float
        Relative to Young's modulus.
    dynamic : (F, n, 3) float64 or None
        Positions with secondary motion, m.

    Raises
    ------
    ValueError
        Naming the array, what was found and what was expected.
    """

    rest_positions: FloatArray
    tets: IntArray
    constrained: NDArray[np.bool_]
    youngs_modulus: FloatArray
    dt: float
    reference: FloatArray
    density: float | FloatArray = 1000.0
    poisson_ratio: float = 0.45
    compression_resistance: float = 1e5
    dynamic: FloatArray | None = None

    def __post_init__(self) -> None:
        rest = _reals("rest_positions", self.rest_positions, "(n, 3)", (None, 3))
        count = len(rest)
        if count == 0:
            raise ValueError("rest_positions: found no vertices, expected at least one")
        tets = _indices("tets", self.tets, count)
        constrained = _flags("constrained", self.constrained, count)
        modulus = _reals("youngs_modulus", self.youngs_modulus, f"({count},)", (count,))
        _require(modulus > 0, "youngs_modulus", modulus, "more than 0 Pa")
        reference = _reals("reference", self.reference, f"(frames, {count}, 3)", (None, count, 3))
        if len(reference) == 0:
            raise ValueError("reference: found no frames, expected at least one")
        density: float | FloatArray
        if np.ndim(self.density) == 0:
            density = _real("density", self.density)
        else:
            density = _reals("density", self.density, f"() or ({count},)", (count,))
        _require(np.asarray(density) > 0, "density", np.asarray(density), "more than 0 kg/m³")
        dt, poisson, resistance = (
            _real(name, getattr(self, name)) for name in ("dt", "poisson_ratio", "compression_resistance")
        )
        if dt <= 0:
            raise ValueError(f"dt: found {dt:g}, expected a positive number of seconds")
        if not -1 < poisson < 0.5:
            raise ValueError(f"poisson_ratio: found {poisson:g}, expected between -1 and 0.5")
        if resistance < 0:
            raise ValueError(f"compression_resistance: found {resistance:g}, expected 0 or more")
        dynamic = None
        if self.dynamic is not None:
            dynamic = _reals("dynamic", self.dynamic, f"{reference.shape}, as reference", reference.shape)
        checked = (rest, tets, constrained, modulus, dt, reference, density, poisson, resistance, dynamic)
        for field, value in zip(fields(self), checked, strict=True):
            object.__setattr__(self, field.name, value)

    @property
    def frame_count(self) -> int:
        """Number of frames, F."""
        return len(self.reference)

    @property
    def vertex_count(self) -> int:
        """Number of vertices, n."""
        return len(self.rest_positions)

    @classmethod
    def load(cls, path: Path | str) -> Self:
        """Read a sequence file.

        Raises
        ------
        ValueError
            Where the file cannot be read, misses a key, has one too many or holds an array that does not fit;
            names the file.
        """
        arrays = read_npz(path)
        keys = [field.name for field in fields(cls)]
        required = ("rest_positions", "tets", "constrained", "youngs_modulus", "dt", "reference")
        missing = [key for key in required if key not in arrays]
        unknown = sorted(set(arrays) - set(keys))
        if missing:
            found = ", ".join(arrays) or "no arrays at all"
            raise ValueError(f"{path}: found no {', '.join(missing)}, expected a sequence file (it holds {found})")
        if unknown:
            raise ValueError(f"{path}: found unknown {', '.join(unknown)}, expected only {', '.join(keys)}")
        try:
            return cls(**arrays)  # type: ignore[arg-type]  # __post_init__ checks and converts
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def save(self, path: Path | str, precision: Literal["float32", "float64"] = "float64") -> None:
        """Write a sequence file, all or nothing.

        Parameters
        ----------
        path
            The file.
        precision
            What the positions of the frames are stored in; everything else is stored as it is.

        Raises
        ------
        ValueError
            Where the folder is missing.
        """
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays = {name: np.asarray(value) for name, value in arrays.items() if value is not None}
        for name in ("reference", "dynamic"):
            if name in arrays:
                arrays[name] = arrays[name].astype(precision, copy=False)
        write_npz(path, arrays)


def _reals(name: str, values: Any, expected: str, shape: tuple[int | None, ...]) -> FloatArray:
    array = np.asarray(values)
    fits = len(shape) == array.ndim and all(want in (None, has) for want, has in zip(shape, array.shape, strict=True))
    if not fits:
        raise ValueError(f"{name}: found shape {array.shape}, expected {expected}")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: found {array.dtype}, expected real numbers")
    array = np.ascontiguousarray(array, dtype=np.float64)
    _require(np.isfinite(array), name, array, "finite numbers")
    return array


def _real(name: str, value: Any) -> float:
    array = np.asarray(value)
    if array.ndim != 0:
        raise ValueError(f"{name}: found shape {array.shape}, expected a single number")
    if array.dtype.kind not in "fiu":
        raise ValueError(f"{name}: found {array.dtype}, expected a real number")
    if not np.isfinite(array):
        raise ValueError(f"{name}: found {array}, expected a finite number")
    return float(array)


def _flags(name: str, values: Any, count: int) -> NDArray[np.bool_]:
    array = np.asarray(values)
    if array.shape != (count,):
        raise ValueError(f"{name}: found shape {array.shape}, expected ({count},)")
    if array.dtype != np.bool_:
        raise ValueError(f"{name}: found {array.dtype}, expected bool")
    return array


def _indices(name: str, values: Any, count: int) -> IntArray:
    array = np.asarray(values)
    if array.ndim != 2 or array.shape[1] != 4:
        raise ValueError(f"{name}: found shape {array.shape}, expected (m, 4)")
    if array.dtype.kind not in "iu":
        raise ValueError(f"{name}: found {array.dtype}, expected integers")
    _require((array >= 0) & (array < count), name, array, f"indices 0 to {count - 1}")
    return np.ascontiguousarray(array, dtype=np.int32)


def _require(fine: NDArray[np.bool_], name: str, values: NDArray[Any], expected: str) -> None:
    if not np.all(fine):
        place = tuple(int(i) for i in np.argwhere(~np.atleast_1d(fine))[0])
        where = f" at {list(place)}" if np.ndim(fine) else ""
        raise ValueError(f"{name}: found {np.atleast_1d(values)[place]}{where}, expected {expected}")
