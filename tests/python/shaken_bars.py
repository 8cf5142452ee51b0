# SPDX-License-Identifier: GPL-3.0-or-later
"""A recipe of tiny data sets: a bar of two cubes, held at one end. A module of its own, so that worker processes find it."""

import itertools
from dataclasses import dataclass

import numpy as np

from followthrough.datasets.recipes import Item, Setting, random_numbers
from followthrough.sequences import Sequence

_TETS = np.array([(0, 4, 2, 1), (4, 2, 1, 5), (2, 1, 5, 3), (4, 6, 2, 5), (6, 5, 7, 3), (6, 2, 5, 3)], dtype=np.int32)


@dataclass(frozen=True)
class BarRecipe:
    seed: int
    frames: int = 15
    still: int = 0
    kind = "bar"
    version = 1

    def settings(self) -> dict[str, Setting]:
        return {"frames": self.frames, "still": self.still}

    def items(self, motions: int) -> list[Item]:
        return [Item(f"bar-{motion:04d}.npz", motion, self.frames, {"pushed": True}) for motion in range(motions)]

    def make(self, item: Item) -> Sequence:
        rest = np.array(list(itertools.product(range(3), range(2), range(2))), dtype=float) * 0.2
        push = random_numbers(self.kind, self.seed, item.motion).random(3) * 0.03
        return Sequence(
            rest_positions=rest,
            tets=np.concatenate([_TETS, _TETS + 4]),
            constrained=rest[:, 0] < 0.1,
            youngs_modulus=np.full(len(rest), 1e5),
            dt=0.03,
            reference=rest + np.maximum(np.arange(self.frames) - self.still, 0)[:, None, None] ** 2 * push,
        )
