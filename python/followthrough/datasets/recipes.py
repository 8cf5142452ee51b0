# SPDX-License-Identifier: GPL-3.0-or-later
"""What a data set is made of: a recipe gives the sequences, without their dynamics, from a seed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from followthrough.sequences import Sequence

#: What a manifest can hold.
Setting = bool | int | float | str | list[float] | None


@dataclass(frozen=True)
class Item:
    """One sequence of a data set.

    Attributes
    ----------
    name : str
        Of its file, with the suffix.
    motion : int
        Which motion it shows, from 0.
    frames : int
        How many.
    facts : mapping
        What tells it from the others, for the manifest.
    """

    name: str
    motion: int
    frames: int
    facts: Mapping[str, Setting] = field(default_factory=dict)


class Recipe(Protocol):
    """How the sequences of a kind of data set are made. Sent to other processes, so of plain values."""

    @property
    def kind(self) -> str:
        """Its name on the command line and in the manifest."""

    @property
    def version(self) -> int:
        """Raised when the same settings come to mean other sequences."""

    @property
    def seed(self) -> int:
        """What the random numbers start from."""

    def settings(self) -> dict[str, Setting]:
        """Everything else that the sequences depend on, but not how many there are."""

    def items(self, motions: int) -> list[Item]:
        """The sequences of so many motions; those of fewer motions are among them, unchanged."""

    def make(self, item: Item) -> Sequence:
        """A sequence without its dynamics. Depends on the recipe and the item alone."""


def random_numbers(kind: str, seed: int, motion: int) -> np.random.Generator:
    """Random numbers of one motion, independent of those of any other motion, seed or kind."""
    return np.random.default_rng([seed, motion, *kind.encode()])


def checked_seed(seed: int) -> int:
    """Refuse a seed that is no random generator's.

    Raises
    ------
    ValueError
    """
    if not 0 <= seed < 2**63:
        raise ValueError(f"seed: found {seed}, expected a whole number from 0 to 2**63 - 1")
    return seed


def log_uniform(random: np.random.Generator, low: float, high: float) -> float:
    """A number between two positive ones, its logarithm spread evenly."""
    return float(low * (high / low) ** random.random())


def unit_vector(random: np.random.Generator) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """A direction, all equally likely."""
    height = 2.0 * random.random() - 1.0
    angle = 2.0 * np.pi * random.random()
    across = np.sqrt(1.0 - height * height)
    return np.array([across * np.cos(angle), across * np.sin(angle), height])
