# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs a solver over a sequence."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from followthrough.character import FloatArray
from followthrough.npz_files import read_npz
from followthrough.sequences import Sequence
from followthrough.settings import SpringSettings

if TYPE_CHECKING:
    from followthrough.solver import Solver


#: Spring stiffness where none is given, 1/s²: the middle of the range that artists paint, on its logarithmic scale.
DEFAULT_STIFFNESS = math.sqrt(math.prod(SpringSettings().stiffness_range))
#: Share of critical damping where no damping is given.
DEFAULT_DAMPING_RATIO = SpringSettings().damping_ratio


def simulate(
    sequence: Sequence, solver: Solver, frames: Callable[[range], Iterable[int]] = lambda frames: frames
) -> Sequence:
    """Fill in a sequence's dynamic positions.

    Parameters
    ----------
    sequence
        The motion; its first frame is where the simulation starts, without secondary motion (over static equilibria, in its own).
    solver
        Made for this sequence's vertices and dt.
    frames
        Wraps the range of frames, for example into a progress bar.

    Returns
    -------
    Sequence
        The same with `dynamic`.

    Raises
    ------
    ValueError
        Naming the frame where the result stops being finite.
    """
    reference = sequence.reference
    dynamic = np.empty_like(reference)
    dynamic[0] = solver.reset(reference[0])
    for frame in frames(range(1, sequence.frame_count)):
        ahead = reference[frame + 1] if frame + 1 < sequence.frame_count else None
        dynamic[frame] = solver.step(reference[frame], ahead)
        if not np.isfinite(dynamic[frame]).all():
            raise ValueError(
                f"dynamic: found non-finite positions in frame {frame}, expected finite ones (is the motion sound?)"
            )
    return replace(sequence, dynamic=dynamic)


def uniform_constants(
    vertex_count: int, stiffness: float | None = None, damping: float | None = None
) -> tuple[FloatArray, FloatArray]:
    """Spring constants that are the same everywhere.

    Parameters
    ----------
    vertex_count
        Number of vertices, n.
    stiffness
        ks, 1/s²; None: `DEFAULT_STIFFNESS`.
    damping
        kd, 1/s; None: `DEFAULT_DAMPING_RATIO` of critical damping, 2 sqrt(ks).

    Returns
    -------
    (n,) float64, (n,) float64
        ks and kd.
    """
    ks = DEFAULT_STIFFNESS if stiffness is None else stiffness
    for name, value in (("stiffness", ks), ("damping", damping)):
        if value is not None and not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}: found {value:g}, expected a finite number, 0 or more")
    kd = 2.0 * DEFAULT_DAMPING_RATIO * math.sqrt(ks) if damping is None else damping
    return np.full(vertex_count, ks), np.full(vertex_count, kd)


def load_constants(path: Path | str, vertex_count: int) -> tuple[FloatArray, FloatArray]:
    """Read spring constants: an .npz with `ks` (n,) in 1/s² and `kd` (n,) in 1/s.

    Raises
    ------
    ValueError
        Where the file cannot be read, misses an array or has one too many, or they do not fit; names the file.
    """
    arrays = read_npz(path)
    if set(arrays) != {"ks", "kd"}:
        found = ", ".join(arrays) or "no arrays at all"
        raise ValueError(f"{path}: found {found}, expected exactly ks and kd")
    for name, values in arrays.items():
        if values.shape != (vertex_count,) or values.dtype.kind not in "fiu":
            raise ValueError(
                f"{path}: {name}: found shape {values.shape} of {values.dtype}, expected ({vertex_count},) real numbers"
            )
        if not np.all(np.isfinite(values) & (values >= 0)):
            raise ValueError(f"{path}: {name}: found negative or non-finite values, expected finite numbers, 0 or more")
    return arrays["ks"].astype(np.float64), arrays["kd"].astype(np.float64)
