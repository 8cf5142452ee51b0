# SPDX-License-Identifier: GPL-3.0-or-later
"""One object while it is baked."""

from __future__ import annotations

import concurrent.futures
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from followthrough.blender.probes import OffsetFinder
from followthrough.blender.rig_reading import PoseReader
from followthrough.character import FloatArray
from followthrough.secondary_motion import SecondaryMotion


@dataclass
class BakedCharacter:
    """One object while it is baked, and what has been found so far."""

    name: str
    made: concurrent.futures.Future[SecondaryMotion]
    reader: PoseReader
    finder: OffsetFinder | None
    rest_positions: FloatArray
    #: One a keyed frame; until a finder has found the offset, the displacement in the world.
    offsets: NDArray[np.float32]
    unkeyed: NDArray[np.float32]
    largest_displacement: float = 0.0
    largest_residual: float = 0.0
    evaluations: int = 0
    #: Frames whose offsets a finder has found.
    found: int = 0
    unconverged: set[int] = field(default_factory=set)

    @property
    def motion(self) -> SecondaryMotion:
        """What `made` makes; waits for it."""
        return self.made.result()

    def abandon(self) -> None:
        """Leave a frame under way to itself."""
        if self.made.done() and not self.made.cancelled() and self.made.exception() is None:
            self.motion.abandon()
