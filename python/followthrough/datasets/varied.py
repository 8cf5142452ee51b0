# SPDX-License-Identifier: GPL-3.0-or-later
"""Training data beyond the sphere: many shapes, lively motions, any stiffness, painted materials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from followthrough.datasets.gestures import random_pose
from followthrough.datasets.recipes import Item, Setting, checked_seed, log_uniform, random_numbers
from followthrough.datasets.shapes import FAMILIES, random_body, smooth_field
from followthrough.sequences import Sequence

#: Range of s = E h² / (ρ L²), which is all that matters of stiffness, frame time, density and edge.
STIFFNESS_RANGE = (0.5, 150.0)
#: Hardest acceleration of what is held, edges a frame, a frame; and its highest speed, edges a frame.
_ACCELERATIONS, _TOP_SPEED = (0.08, 1.0), 2.0
_FRAME_RATES = (24.0, 25.0, 30000 / 1001, 30.0, 60.0)
_EDGES, _DENSITIES = (0.01, 0.5), (300.0, 3000.0)


@dataclass(frozen=True)
class ShapesRecipe:
    """A shape, a motion and a material of its own in every sequence.

    Parameters
    ----------
    seed
        0 or more.
    frames
        Of a motion.
    stiffness_range
        Of s, as drawn evenly in the logarithm; a painted material stays within it.

    Raises
    ------
    ValueError
        On a negative seed, a range that is none, or fewer than 20 frames.
    """

    seed: int
    frames: int = 120
    stiffness_range: tuple[float, float] = STIFFNESS_RANGE
    kind = "shapes"
    version = 1

    def __post_init__(self) -> None:
        checked_seed(self.seed)
        low, high = self.stiffness_range
        if not 0 < low <= high < float("inf"):
            raise ValueError(f"stiffness_range: found {low:g} to {high:g}, expected two positive numbers in order")
        if self.frames < 20:
            raise ValueError(f"frames: found {self.frames}, expected 20 or more")

    def settings(self) -> dict[str, Setting]:
        """Number of frames and range of stiffness."""
        return {"frames": self.frames, "stiffness_range": list(self.stiffness_range)}

    def items(self, motions: int) -> list[Item]:
        """A file a motion; families of shapes take turns."""
        names = list(FAMILIES)
        families = [names[motion % len(names)] for motion in range(motions)]
        return [
            Item(f"shape-{motion:05d}-{family}.npz", motion, self.frames, {"family": family})
            for motion, family in enumerate(families)
        ]

    def make(self, item: Item) -> Sequence:
        """One shape in one motion."""
        random = random_numbers(self.kind, self.seed, item.motion)
        body, at_rest = random_body(random, str(item.facts["family"]))
        pose = random_pose(random, self.frames, body.skeleton.bone_count)
        pose = body.paced(pose, log_uniform(random, *_ACCELERATIONS), _TOP_SPEED).after(at_rest)
        reference = body.reference(pose)

        dt = 1.0 / _FRAME_RATES[int(random.random() * len(_FRAME_RATES))]
        edge = log_uniform(random, *_EDGES)
        density = log_uniform(random, *_DENSITIES)
        stiffness = np.full(len(body.vertices), log_uniform(random, *self.stiffness_range))
        densities = density
        if random.random() < 0.6:
            contrast = np.log(log_uniform(random, 1.5, 12.0))
            stiffness = np.clip(
                stiffness * np.exp(contrast * smooth_field(random, body.vertices)), *self.stiffness_range
            )
        if random.random() < 0.4:
            densities = density * np.exp(np.log(2.0) * smooth_field(random, body.vertices))
        return Sequence(
            rest_positions=edge * reference[0],
            tets=body.tets,
            constrained=body.constrained,
            youngs_modulus=stiffness * densities * edge**2 / dt**2,
            dt=dt,
            reference=edge * reference,
            density=densities,
        )
