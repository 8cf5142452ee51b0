# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist can set for a bake, in physical units, checked when it is made."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

VolumeMethod = Literal["voxel", "tetgen"]


def _require_range(name: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high):
        raise ValueError(f"{name}: found {low:g} to {high:g}, expected two finite numbers with 0 < low <= high")


@dataclass(frozen=True)
class SpringSettings:
    """Constants of the zero-restlength springs ([ZS] section 5) that painted values are mapped to.

    Parameters
    ----------
    stiffness_range
        Spring stiffness ks (1/s², divided by the mass) where the stiffness group is painted 0 and 1; between them the scale is
        logarithmic. A spring of stiffness ks swings at sqrt(ks) / 2 pi hertz.
    damping_ratio
        Share of critical damping at neutral mass: 0 swings for ever, 1 and more does not swing at all. Unused where `damping` is given.
    damping
        Spring damping kd (1/s, divided by the mass), the same everywhere; None: from `damping_ratio`.
    mass_range
        Mass factor where the mass group is painted 0 and 1, logarithmic between; both constants are divided by it.
    """

    stiffness_range: tuple[float, float] = (250.0, 4000.0)
    damping_ratio: float = 0.25
    damping: float | None = None
    mass_range: tuple[float, float] = (0.25, 4.0)

    def __post_init__(self) -> None:
        _require_range("stiffness_range", *self.stiffness_range)
        _require_range("mass_range", *self.mass_range)
        for name in ("damping_ratio", "damping"):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name}: found {value:g}, expected a finite number, 0 or more")


@dataclass(frozen=True)
class VolumeSettings:
    """How the simulated volume is made around a character.

    Parameters
    ----------
    cells
        Voxel cells along the longest side of the character at rest. [DE] uses 25.
    split_parts
        Do not glue parts of the body (thighs, fingers, lips) that merely come near each other.
    method
        "voxel" takes any surface; "tetgen" fills a closed surface exactly and needs the tetgen extra.
    core_radius
        Vertices of the volume that lie inside it, carry no surface vertex and are nearer to a deforming bone than this share of
        the character's usual flesh thickness are pinned [ZS 3.1]. 0 turns that off.
    """

    cells: int = 25
    split_parts: bool = True
    method: VolumeMethod = "voxel"
    core_radius: float = 0.35

    def __post_init__(self) -> None:
        if self.cells < 1:
            raise ValueError(f"cells: found {self.cells}, expected 1 or more")
        if not (math.isfinite(self.core_radius) and self.core_radius >= 0):
            raise ValueError(f"core_radius: found {self.core_radius:g}, expected a finite number, 0 or more")
        if self.method not in ("voxel", "tetgen"):
            raise ValueError(f"method: found {self.method!r}, expected 'voxel' or 'tetgen'")


@dataclass(frozen=True)
class Settings:
    """All settings of one character's bake.

    Parameters
    ----------
    volume, springs
        See there.
    minimum_stretch
        Inverse skinning never divides by a stretch smaller than this: where the rig flattens the skin, the shape key stays bounded and
        the part of the motion that it cannot show is reported as the residual.
    """

    volume: VolumeSettings = field(default_factory=VolumeSettings)
    springs: SpringSettings = field(default_factory=SpringSettings)
    minimum_stretch: float = 0.05

    def __post_init__(self) -> None:
        if not (math.isfinite(self.minimum_stretch) and 0 < self.minimum_stretch <= 1):
            raise ValueError(f"minimum_stretch: found {self.minimum_stretch:g}, expected more than 0 and at most 1")
