# SPDX-License-Identifier: GPL-3.0-or-later
"""The vertex groups that an artist paints: stiffness, mass and pins."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from followthrough.character import FloatArray, Paint, Surface

STIFFNESS_GROUP = "Followthrough Stiffness"
MASS_GROUP = "Followthrough Mass"
PINS_GROUP = "Followthrough Pins"


@dataclass(frozen=True)
class PinGroup:
    """A vertex group that pins, and how strongly: its weights are multiplied by `strength` (0 to 1)."""

    name: str
    strength: float = 1.0


@dataclass(frozen=True)
class PaintGroups:
    """Which vertex groups are read.

    Parameters
    ----------
    stiffness, mass
        Group names; None: the usual group where the mesh has it, otherwise `suggest_paint`.
    pins
        Several groups may pin, the strongest wins; None as above. An empty tuple: nothing is pinned.
    """

    stiffness: str | None = None
    mass: str | None = None
    pins: tuple[PinGroup, ...] | None = None


def add_groups(obj: bpy.types.Object, surface: Surface | None = None) -> list[str]:
    """Create those of the three usual groups that the mesh does not have yet, filled with suggested values.

    Returns
    -------
    Names of the groups that were created; groups that were there are not touched.
    """
    raise NotImplementedError


def read_paint(obj: bpy.types.Object, surface: Surface, groups: PaintGroups | None = None) -> Paint:
    """Read what is painted.

    Raises
    ------
    ValueError
        Where a group that is named does not exist.
    """
    raise NotImplementedError


def write_group(obj: bpy.types.Object, name: str, values: FloatArray) -> None:
    """Set every vertex's weight (v,), 0 to 1, in the group of that name, which is created where it is missing."""
    raise NotImplementedError
