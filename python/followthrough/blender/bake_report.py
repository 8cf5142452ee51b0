# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake has done, and what about it an artist should know."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

#: Residuals below this share of the largest displacement are not worth a word.
_NOTABLE_RESIDUAL = 0.05


@dataclass(frozen=True)
class ObjectReport:
    """What was baked on one object.

    Attributes
    ----------
    frames, vertices, tets : int
    largest_displacement : float
        Of all vertices and frames, metres in the world.
    largest_residual : float
        Largest part of a displacement that no shape key can show because the rig flattens or smooths the skin there, metres.
    evaluations_per_frame : float
        Where something else than a plain Armature modifier moves the mesh: how often Blender had to evaluate it for a frame to find
        its offsets. 0 where bones told all.
    loose_vertices : int
        Vertices of the mesh in parts that no pin holds, where the solver needs one; they follow the armature.
    unconverged : tuple of int
        Frames, also such that were not keyed, in which the solver was not as exact as its quality promises;
        "preview" promises nothing.
    caution : str
        What was known to be beyond the solver before the bake began (`Bake.cautions`); none where empty.
    """

    name: str
    frames: int
    vertices: int
    tets: int
    largest_displacement: float
    largest_residual: float
    evaluations_per_frame: float = 0.0
    loose_vertices: int = 0
    unconverged: tuple[int, ...] = ()
    caution: str = ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences for the artist, none where all went well."""
        found = []
        if self.caution:
            found.append(f"{self.name}: {self.caution}")
        if not self.largest_displacement:
            found.append(f"{self.name}: nothing swings, because nothing moves in these frames; look at its animation")
        if self.largest_residual > _NOTABLE_RESIDUAL * self.largest_displacement:
            found.append(
                f"{self.name}: the rig flattens or smooths the skin somewhere, where up to "
                f"{1000 * self.largest_residual:.2g} mm of the motion cannot be shown"
            )
        if self.loose_vertices:
            found.append(
                f"{self.name}: no pin holds {self.loose_vertices} vertices of loose parts, which follow the armature; "
                "paint pins on them"
            )
        if self.unconverged:
            count = f"{len(self.unconverged)} frame{'s have' if len(self.unconverged) > 1 else ' has'}"
            found.append(
                f"{self.name}: {count} not converged ({_ranges(self.unconverged)}); look at them, and try stiffer "
                "flesh or another quality where they are wrong"
            )
        return tuple(found)


@dataclass(frozen=True)
class BakeReport:
    """What was baked, and how long it took, from the making of the volumes to the last key."""

    objects: tuple[ObjectReport, ...]
    start: int
    end: int
    seconds: float


def _ranges(frames: Iterable[int], most: int = 6) -> str:
    """Ascending frames in words: `3, 7-9, 12`."""
    runs: list[list[int]] = []
    for frame in frames:
        if runs and frame == runs[-1][1] + 1:
            runs[-1][1] = frame
        else:
            runs.append([frame, frame])
    words = [str(first) if first == last else f"{first}-{last}" for first, last in runs]
    return ", ".join(words[:most]) + (" ..." if len(words) > most else "")
