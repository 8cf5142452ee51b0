# SPDX-License-Identifier: GPL-3.0-or-later
"""The networks of a patch-corrected Newton emulator: what its passes are, and the parameters that each of them needs."""

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
Layer = tuple[Float32Array, Float32Array | None]

#: What a pass's network can be told as vectors (`cpp/include/followthrough/emulator/newton_patches.hpp`).
CHANNELS = "gplwsar"
#: Names that parameters of a pass can have.
PARAMETER = re.compile(
    r"passes\.\d+\.(edge\.\d+\.weight|edge\.[1-9]\d*\.bias|centre\.(weight|bias)|instance\.\d+\.(weight|bias)|out\.weight|skip)"
)


@dataclass(frozen=True)
class NewtonPass:
    """One pass of a frame.

    Attributes
    ----------
    iterations
        Of the conjugate gradients, at most; 0 or more.
    channels
        Letters of the vectors that the pass's network is told, each once; None: the pass has no network and steps along the direction.
    """

    iterations: int
    channels: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.iterations, int) or isinstance(self.iterations, bool) or self.iterations < 0:
            raise ValueError(f"iterations: found {self.iterations!r}, expected a whole number, 0 or more")
        if self.iterations > 10_000:
            raise ValueError(f"iterations: found {self.iterations}, expected at most 10000")
        if self.channels is not None:
            known = isinstance(self.channels, str) and self.channels and set(self.channels) <= set(CHANNELS)
            if not known or len(set(self.channels)) < len(self.channels):
                raise ValueError(
                    f"channels: found {self.channels!r}, expected some of the letters {', '.join(CHANNELS)}, each once"
                )


@dataclass(frozen=True)
class NewtonSchedule:
    """How a frame is solved.

    Attributes
    ----------
    passes
        One after the other; at least one.
    beta
        Where a frame starts between the inertial guess, 0, and the reference's motion from u(t) on, 1.
    """

    passes: tuple[NewtonPass, ...]
    beta: float = 0.5

    def __post_init__(self) -> None:
        if not self.passes:
            raise ValueError("passes: found none, expected at least one")
        if not (math.isfinite(self.beta) and 0 <= self.beta <= 1):
            raise ValueError(f"beta: found {self.beta}, expected 0 to 1")

    @classmethod
    def from_metadata(cls, passes: Any, beta: Any) -> NewtonSchedule:
        """Of what a weights file says."""
        return cls(tuple(NewtonPass(entry["iterations"], entry["channels"]) for entry in passes), float(beta))

    def metadata(self) -> dict[str, Any]:
        """What a weights file says."""
        passes = [{"iterations": entry.iterations, "channels": entry.channels} for entry in self.passes]
        return {"passes": passes, "beta": self.beta}


def dimensions_of(name: str) -> int:
    """Dimensions of a parameter.

    Raises
    ------
    ValueError
        Where no pass has one of that name.
    """
    if not PARAMETER.fullmatch(name):
        raise ValueError(f"found {name}, expected only parameters of passes such as passes.0.edge.0.weight")
    return 2 if name.endswith(".weight") else 1


def layers(parameters: Mapping[str, Float32Array], place: str) -> list[Layer]:
    """Layers `place`.0, `place`.1 and so on, as far as they go."""
    found: list[Layer] = []
    while (weight := parameters.get(f"{place}.{len(found)}.weight")) is not None:
        found.append((weight, parameters.get(f"{place}.{len(found)}.bias")))
    return found


def require_parameters(parameters: Mapping[str, Float32Array], schedule: NewtonSchedule) -> None:
    """Check that every pass has what it needs and nothing else.

    Raises
    ------
    ValueError
        Naming the parameter, what was found and what was expected.
    """
    expected: dict[str, tuple[int, ...]] = {}
    for k, entry in enumerate(schedule.passes):
        if entry.channels is not None:
            expected |= _expected(parameters, f"passes.{k}", 3 * len(entry.channels))
    unknown = sorted(set(parameters) - set(expected))
    if unknown:
        raise ValueError(
            f"found {', '.join(unknown[:5])}, expected only parameters of the passes that have channels, layers without gaps"
        )
    for name, shape in expected.items():
        if name not in parameters:
            raise ValueError(f"found no {name}, expected one of shape {shape}")
        if parameters[name].shape != shape:
            raise ValueError(f"{name}: found shape {parameters[name].shape}, expected {shape}")


def _expected(parameters: Mapping[str, Float32Array], place: str, vectors: int) -> dict[str, tuple[int, ...]]:
    """Shapes of a pass's parameters, given the number of outputs of its layers."""
    shapes: dict[str, tuple[int, ...]] = {}

    def chain(name: str, inputs: int, first_bias: bool) -> int:
        found = layers(parameters, f"{place}.{name}")
        if not found:
            raise ValueError(f"found no {place}.{name}.0.weight, expected at least one layer")
        for k, (weight, _) in enumerate(found):
            shapes[f"{place}.{name}.{k}.weight"] = (len(weight), inputs)
            inputs = len(weight)
            if k > 0 or first_bias:
                shapes[f"{place}.{name}.{k}.bias"] = (inputs,)
        return inputs

    width = chain("edge", vectors + 8, first_bias=False)
    first = len(parameters[f"{place}.edge.0.weight"])
    shapes[f"{place}.centre.weight"] = (first, vectors + 17)
    shapes[f"{place}.centre.bias"] = (first,)
    shapes[f"{place}.out.weight"] = (3, chain("instance", width + vectors + 17, first_bias=True))
    shapes[f"{place}.skip"] = (1,)
    return shapes


def core_passes(parameters: Mapping[str, Float32Array], schedule: NewtonSchedule) -> list[Any]:
    """The passes as the core takes them."""
    passes: list[Any] = []
    for k, entry in enumerate(schedule.passes):
        if entry.channels is None:
            passes.append(_core.NewtonPass(entry.iterations))
            continue
        place = f"passes.{k}"
        passes.append(
            _core.NewtonPass(
                entry.iterations,
                entry.channels,
                layers(parameters, f"{place}.edge"),
                (parameters[f"{place}.centre.weight"], parameters[f"{place}.centre.bias"]),
                layers(parameters, f"{place}.instance"),
                (parameters[f"{place}.out.weight"], None),
                float(parameters[f"{place}.skip"][0]),
            )
        )
    return passes
