# SPDX-License-Identifier: GPL-3.0-or-later
"""The guides of an emulator that takes guided Newton steps: what its passes are, and the parameters that each of them needs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from followthrough import _core

Float32Array = NDArray[np.float32]
Layer = tuple[Float32Array, Float32Array]

#: Vectors and numbers that a guide is told (`cpp/include/followthrough/emulator/newton_patches.hpp`).
START_SIZE: tuple[int, int] = tuple(_core.start_guide_size)
PASS_SIZE: tuple[int, int] = tuple(_core.pass_guide_size)
#: Names that parameters can have.
PARAMETER = re.compile(r"(start|passes\.\d+)\.\d+\.(weight|bias)")
_MOST_ITERATIONS, _MOST_PASSES = 10_000, 1000


@dataclass(frozen=True)
class NewtonSchedule:
    """How a frame is solved.

    Attributes
    ----------
    iterations
        Of the conjugate gradients, at most, pass by pass; the last pass is repeated. None: the first estimate is the frame.
    most_passes
        Of a frame.
    tolerance
        Edges; passes end where what they would still move the vertices by, judged by the rate at which the residual falls, is less (root
        mean square). In frames whose first step is shorter than a tenth of an edge it is smaller in proportion.
    """

    iterations: tuple[int, ...] = (32, 32)
    most_passes: int = 16
    tolerance: float = 1e-3

    def __post_init__(self) -> None:
        object.__setattr__(self, "iterations", tuple(self.iterations))
        for count in self.iterations:
            _require_count("iterations", count, _MOST_ITERATIONS)
        _require_count("most_passes", self.most_passes, _MOST_PASSES)
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0):
            raise ValueError(f"tolerance: found {self.tolerance}, expected 0 edges or more")

    @classmethod
    def from_metadata(cls, values: Mapping[str, Any]) -> NewtonSchedule:
        """Of what a weights file says."""
        return cls(tuple(values["iterations"]), values["most_passes"], float(values["tolerance"]))

    def metadata(self) -> dict[str, Any]:
        """What a weights file says."""
        return {"iterations": list(self.iterations), "most_passes": self.most_passes, "tolerance": self.tolerance}

    def guides(self) -> dict[str, tuple[int, int]]:
        """Names of the guides, with the numbers of vectors and of other numbers that each is told."""
        return {"start": START_SIZE, **{f"passes.{k}": PASS_SIZE for k in range(len(self.iterations))}}


def guide_inputs(size: tuple[int, int]) -> int:
    """Number of a guide's inputs."""
    vectors, scalars = size
    return vectors * (vectors + 1) // 2 + scalars


def dimensions_of(name: str) -> int:
    """Dimensions of a parameter.

    Raises
    ------
    ValueError
        Where no guide has one of that name.
    """
    if not PARAMETER.fullmatch(name):
        raise ValueError(f"found {name}, expected only parameters of guides such as start.0.weight or passes.0.1.bias")
    return 2 if name.endswith(".weight") else 1


def layers(parameters: Mapping[str, Float32Array], guide: str) -> list[Layer]:
    """A guide's layers, as far as they go."""
    found: list[Layer] = []
    while (weight := parameters.get(f"{guide}.{len(found)}.weight")) is not None:
        found.append((weight, parameters[f"{guide}.{len(found)}.bias"]))
    return found


def require_parameters(parameters: Mapping[str, Float32Array], schedule: NewtonSchedule) -> None:
    """Check that every guide has what it needs, and that there is nothing else.

    Raises
    ------
    ValueError
        Naming the parameter, what was found and what was expected.
    """
    expected: dict[str, tuple[int, ...]] = {}
    for guide, size in schedule.guides().items():
        width, depth = guide_inputs(size), 0
        while f"{guide}.{depth}.weight" in parameters:
            outputs = len(parameters[f"{guide}.{depth}.weight"])
            if f"{guide}.{depth + 1}.weight" not in parameters:
                outputs = size[0]
            expected |= {f"{guide}.{depth}.weight": (outputs, width), f"{guide}.{depth}.bias": (outputs,)}
            width, depth = outputs, depth + 1
        if not depth:
            raise ValueError(f"found no {guide}.0.weight, expected at least one layer")
    unknown = sorted(set(parameters) - set(expected))
    if unknown:
        raise ValueError(f"found {', '.join(unknown[:5])}, expected only parameters of the passes, layers without gaps")
    for name, shape in expected.items():
        if name not in parameters:
            raise ValueError(f"found no {name}, expected one of shape {shape}")
        if parameters[name].shape != shape:
            raise ValueError(f"{name}: found shape {parameters[name].shape}, expected {shape}")


def _require_count(name: str, found: Any, most: int) -> None:
    if not isinstance(found, int) or isinstance(found, bool) or not 0 <= found <= most:
        raise ValueError(f"{name}: found {found!r}, expected a whole number, 0 to {most}")
