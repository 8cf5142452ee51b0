# SPDX-License-Identifier: GPL-3.0-or-later
"""What a training run is made of: the network's sizes, how long and how fast it learns. Read from a TOML file."""

from __future__ import annotations

import math
import tomllib
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Self

from followthrough.newton_weights import NewtonSchedule
from followthrough.training.network import PatchNetwork
from followthrough.training.newton_network import GuidedNewtonNetwork
from followthrough.training.optimizers import OPTIMIZERS

Bounds = tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class LearningSettings:
    """How a network learns, whichever it is.

    Attributes
    ----------
    steps : int
        Optimiser steps.
    frames_a_step : int
        Random frames in a step's batch.
    learning_rate : float
        At the end of the warm-up; from there it falls to a hundredth along a cosine.
    warmup_steps : int
        Steps in which it rises from zero.
    optimizer : str
        "adamw", or "muon", which is that for matrices and AdamW for the rest.
    weight_decay : float
        Of either, for a learning rate of 1.
    largest_gradient : float
        Gradients are scaled down to this norm.
    average : float
        Share of the running average of the parameters that a step keeps; the average is what is written. It builds up in the first steps.
    seed : int
        What the random numbers start from.
    """

    architecture: ClassVar[str]
    bounds: ClassVar[Bounds] = (
        ("steps", 1, math.inf),
        ("frames_a_step", 1, math.inf),
        ("learning_rate", 0, math.inf),
        ("warmup_steps", 0, math.inf),
        ("weight_decay", 0, math.inf),
        ("largest_gradient", 0, math.inf),
        ("average", 0, 1),
        ("seed", 0, math.inf),
    )

    steps: int = 20_000
    frames_a_step: int = 16
    learning_rate: float = 1e-3
    warmup_steps: int = 200
    optimizer: str = "adamw"
    weight_decay: float = 0.0
    largest_gradient: float = 1.0
    average: float = 0.999
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low, high in self.bounds:
            value = getattr(self, name)
            if not low <= value <= high or math.isinf(value):
                raise ValueError(f"{name}: found {value}, expected {low} to {high}")
        if self.optimizer not in OPTIMIZERS:
            raise ValueError(f"optimizer: found {self.optimizer!r}, expected {' or '.join(OPTIMIZERS)}")

    def learning_rate_at(self, step: int) -> float:
        """Of a step, counted from 0."""
        if step < self.warmup_steps:
            return self.learning_rate * (step + 1) / self.warmup_steps
        progress = (step - self.warmup_steps) / max(self.steps - self.warmup_steps, 1)
        return self.learning_rate * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * progress)))

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as JSON has them."""
        values = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}
        return {"architecture": self.architecture, **values}

    @classmethod
    def of_table(cls, table: dict[str, Any]) -> Self:
        """Settings of a TOML file's table.

        Raises
        ------
        ValueError
            On an unknown key, or a value of another kind or out of range.
        """
        known = {field.name: field for field in fields(cls)}
        for name, value in table.items():
            if name not in known:
                raise ValueError(f"found unknown {name}, expected only {', '.join(known)}")
            default = known[name].default
            kinds = (
                (list, tuple)
                if isinstance(default, tuple)
                else (int, float)
                if type(default) is float
                else (type(default),)
            )
            if type(value) not in kinds:
                raise ValueError(f"{name}: found {value!r}, expected something like {default!r}")
        return cls(**table)


def _checked_widths(settings: LearningSettings, *names: str) -> None:
    for name in names:
        widths = tuple(getattr(settings, name))
        if not widths or not all(isinstance(width, int) and width > 0 for width in widths):
            raise ValueError(f"{name}: found {list(widths)}, expected widths of layers, 1 or more")
        object.__setattr__(settings, name, widths)


@dataclass(frozen=True)
class TrainingSettings(LearningSettings):
    """The patch network of [DE]. The defaults are the published one, trained with a little noise.

    Attributes
    ----------
    inertia, force, displacement, rings, sees_reference, biases
        The network, as `PatchNetwork` takes them.
    vertices_a_frame : int
        Random free vertices of each frame.
    noise : float
        Standard deviation of what is added to the last three frames of free vertices, in the network's metres: the network learns to
        come back from errors of its own.
    """

    architecture: ClassVar[str] = "patch"
    bounds: ClassVar[Bounds] = (
        *LearningSettings.bounds,
        ("rings", 1, 3),
        ("vertices_a_frame", 1, math.inf),
        ("noise", 0, math.inf),
    )

    inertia: tuple[int, ...] = (64,) * 5
    force: tuple[int, ...] = (128,) * 5
    displacement: tuple[int, ...] = (192,) * 4
    rings: int = 1
    sees_reference: bool = True
    biases: bool = True
    vertices_a_frame: int = 128
    noise: float = 0.002

    def __post_init__(self) -> None:
        _checked_widths(self, "inertia", "force", "displacement")
        if len(self.inertia) < 2 or len(self.force) < 2:
            raise ValueError("inertia, force: found fewer than two layers, expected at least two")
        super().__post_init__()

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


@dataclass(frozen=True)
class NewtonSettings(LearningSettings):
    """The guides of Newton steps. The defaults are those that ship.

    Attributes
    ----------
    iterations : tuple of int
        Of conjugate gradients, pass by pass.
    widths : tuple of int
        Of every guide's hidden layers.
    most_passes, tolerance
        How a frame ends (`newton_weights.NewtonSchedule`).
    repeats : int
        How many times the last pass is repeated while it learns; where a frame is hard it is repeated later on.
    evenness : float
        How much less frames with large errors count: a frame's mean square error is divided by what it was before the pass to this power.
    """

    architecture: ClassVar[str] = "guided-newton"
    bounds: ClassVar[Bounds] = (*LearningSettings.bounds, ("repeats", 0, 100), ("evenness", 0, 1))

    steps: int = 40_000
    frames_a_step: int = 6
    learning_rate: float = 5e-3
    warmup_steps: int = 100
    weight_decay: float = 1e-5
    average: float = 0.998
    iterations: tuple[int, ...] = NewtonSchedule.iterations
    widths: tuple[int, ...] = (24, 24)
    most_passes: int = NewtonSchedule.most_passes
    tolerance: float = NewtonSchedule.tolerance
    repeats: int = 1
    evenness: float = 0.75

    def __post_init__(self) -> None:
        _checked_widths(self, "widths")
        object.__setattr__(self, "iterations", tuple(self.iterations))
        NewtonSchedule(self.iterations, self.most_passes, self.tolerance)  # checks them
        super().__post_init__()

    def network(self) -> GuidedNewtonNetwork:
        """A network of these sizes, not trained."""
        return GuidedNewtonNetwork(
            iterations=self.iterations, widths=self.widths, most_passes=self.most_passes, tolerance=self.tolerance
        )


ARCHITECTURES: dict[str, type[TrainingSettings | NewtonSettings]] = {
    kind.architecture: kind for kind in (NewtonSettings, TrainingSettings)
}


def load_settings(path: Path | str, **changes: Any) -> TrainingSettings | NewtonSettings:
    """Read a TOML file; what it does not name keeps its default, `changes` come on top.

    Raises
    ------
    ValueError
        Where the file cannot be read, has an unknown key or a value out of range; names the file.
    """
    try:
        table = tomllib.loads(Path(path).read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ValueError(f"{path}: found no such file, expected the settings of a training run (TOML)") from None
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ValueError(f"{path}: found no readable TOML ({error})") from None
    architecture = table.pop("architecture", NewtonSettings.architecture)
    if architecture not in ARCHITECTURES:
        raise ValueError(f"{path}: architecture: found {architecture!r}, expected {' or '.join(ARCHITECTURES)}")
    try:
        return ARCHITECTURES[architecture].of_table({**table, **changes})
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
