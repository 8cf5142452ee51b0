# SPDX-License-Identifier: GPL-3.0-or-later
"""Data to measure on, never to train on: characters of their own that dance, in a validation half and a test half."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from followthrough.datasets.characters import Character, eared_one, fat_one, thin_one
from followthrough.datasets.choreography import dance
from followthrough.datasets.recipes import Item, Setting, checked_seed, random_numbers
from followthrough.datasets.spheres import FRAME_TIME
from followthrough.sequences import Sequence

#: Characters by name, and their build in either half.
_CHARACTERS: dict[str, tuple[Callable[[float], Character], dict[str, float]]] = {
    "fat": (fat_one, {"validation": 1.0, "test": 1.15}),
    "thin": (thin_one, {"validation": 1.0, "test": 0.85}),
    "eared": (eared_one, {"validation": 1.0, "test": 1.2}),
}
HALVES = ("validation", "test")
#: m, Pa, kg/m³; as the published characters have them.
_EDGE, _YOUNGS_MODULUS, _DENSITY = 0.2, 5e4, 1000.0


@cache
def _character(name: str, half: str) -> Character:
    make, builds = _CHARACTERS[name]
    return make(builds[half])


@dataclass(frozen=True)
class HeldOutRecipe:
    """Every character in so many dances a half.

    Parameters
    ----------
    seed
        0 or more.
    frames
        Of a dance.

    Raises
    ------
    ValueError
        On a negative seed or fewer than 20 frames.
    """

    seed: int = 0
    frames: int = 240
    kind = "held-out"
    version = 1

    def __post_init__(self) -> None:
        checked_seed(self.seed)
        if self.frames < 20:
            raise ValueError(f"frames: found {self.frames}, expected 20 or more")

    def settings(self) -> dict[str, Setting]:
        """Number of frames."""
        return {"frames": self.frames}

    def items(self, motions: int) -> list[Item]:
        """A file a dance, character and half."""
        return [
            Item(f"{half}-{name}-{motion:04d}.npz", motion, self.frames, {"half": half, "character": name})
            for motion in range(motions)
            for half in HALVES
            for name in _CHARACTERS
        ]

    def make(self, item: Item) -> Sequence:
        """A character in a dance of its own."""
        half, name = str(item.facts["half"]), str(item.facts["character"])
        character = _character(name, half)
        random = random_numbers(f"{self.kind} {half} {name}", self.seed, item.motion)
        reference = _EDGE * character.body.reference(dance(random, self.frames, character.bones))
        return Sequence(
            rest_positions=reference[0],
            tets=character.body.tets,
            constrained=character.body.constrained,
            youngs_modulus=_YOUNGS_MODULUS / character.softness,
            dt=FRAME_TIME,
            reference=reference,
            density=_DENSITY,
        )
