# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training run is made of: the network's sizes, how long and how fast it learns. Read from a TOML file."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from followthrough.training.network import PatchNetwork


@dataclass(frozen=True)
class TrainingSettings:
    """The defaults are the published network, trained with a little noise.

    Attributes
    ----------
    inertia, force, displacement, rings, sees_reference, biases
        The network, as `PatchNetwork` takes them.
    steps : int
        Optimiser steps.
    frames_a_step, vertices_a_frame : int
        Random frames in a step's batch, and random free vertices of each.
    learning_rate : float
        At the end of the warm-up; from there it falls to a hundredth along a cosine.
    warmup_steps : int
        Steps in which it rises from zero.
    weight_decay : float
        Of AdamW.
    largest_gradient : float
        Gradients are scaled down to this norm.
    average : float
        Share of the running average of the parameters that a step keeps; the average is what is written. It builds up in the first steps.
    noise : float
        Standard deviation of what is added to the last three frames of free vertices, in the network's metres: the network learns to
        come back from errors of its own.
    seed : int
        What the random numbers start from.
    """

    inertia: tuple[int, ...] = (64,) * 5
    force: tuple[int, ...] = (128,) * 5
    displacement: tuple[int, ...] = (192,) * 4
    rings: int = 1
    sees_reference: bool = True
    biases: bool = True
    steps: int = 20_000
    frames_a_step: int = 16
    vertices_a_frame: int = 128
    learning_rate: float = 1e-3
    warmup_steps: int = 200
    weight_decay: float = 0.0
    largest_gradient: float = 1.0
    average: float = 0.999
    noise: float = 0.002
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("inertia", "force", "displacement"):
            widths = tuple(getattr(self, name))
            if not widths or not all(isinstance(width, int) and width > 0 for width in widths):
                raise ValueError(f"{name}: found {list(widths)}, expected widths of layers, 1 or more")
            object.__setattr__(self, name, widths)
        if len(self.inertia) < 2 or len(self.force) < 2:
            raise ValueError("inertia, force: found fewer than two layers, expected at least two")
        for name, low, high in (
            ("rings", 1, 3),
            ("steps", 1, math.inf),
            ("frames_a_step", 1, math.inf),
            ("vertices_a_frame", 1, math.inf),
            ("learning_rate", 0, math.inf),
            ("warmup_steps", 0, math.inf),
            ("weight_decay", 0, math.inf),
            ("largest_gradient", 0, math.inf),
            ("average", 0, 1),
            ("noise", 0, math.inf),
            ("seed", 0, math.inf),
        ):
            value = getattr(self, name)
            if not low <= value <= high or math.isinf(value):
                raise ValueError(f"{name}: found {value}, expected {low} to {high}")

    @classmethod
    def load(cls, path: Path | str, **changes: Any) -> Self:
        """Read a TOML file; what it does not name keeps its default, `changes` come on top.

        Raises
        ------
        ValueError
            Where the file cannot be read, has an unknown key or a value out of range; names the file.
        """
        try:
            content = tomllib.loads(Path(path).read_text(encoding="utf-8"))
        except FileNotFoundError:
            raise ValueError(f"{path}: found no such file, expected the settings of a training run (TOML)") from None
        except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise ValueError(f"{path}: found no readable TOML ({error})") from None
        known = {field.name: field for field in fields(cls)}
        for name, value in content.items():
            if name not in known:
                raise ValueError(f"{path}: found unknown {name}, expected only {', '.join(known)}")
            default = known[name].default
            kinds = (
                (list,) if isinstance(default, tuple) else (int, float) if type(default) is float else (type(default),)
            )
            if type(value) not in kinds:
                raise ValueError(f"{path}: {name}: found {value!r}, expected something like {default!r}")
        try:
            return cls(**{**content, **changes})
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None

    def network(self) -> PatchNetwork:
        """A network of these sizes, not trained."""
        return PatchNetwork(
            inertia=self.inertia,
            force=self.force,
            displacement=self.displacement,
            rings=self.rings,
            sees_reference=self.sees_reference,
            biases=self.biases,
        )

    def learning_rate_at(self, step: int) -> float:
        """Of a step, counted from 0."""
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / self.warmup_steps
        progress = (step - self.warmup_steps) / max(self.steps - self.warmup_steps, 1)
        return self.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as JSON has them."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
