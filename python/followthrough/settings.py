# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist can set for a bake, in physical units, checked when it is made."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, get_args

from followthrough import emulator_weights
from followthrough.elastic import QUALITIES, Quality

VolumeMethod = Literal["voxel", "tetgen"]
SolverName = Literal["springs", "emulator", "implicit-euler"]
SOLVERS: tuple[SolverName, ...] = get_args(SolverName)


def default_solver() -> SolverName:
    """What bakes where nothing else is chosen: the emulator, or springs in a version that brings no weights for it."""
    return "emulator" if emulator_weights.are_shipped() else "springs"


def _require_range(name: str, low: float, high: float) -> None:
    if not (math.isfinite(low) and math.isfinite(high) and 0 < low <= high):
        raise ValueError(f"{name}: found {low:g} to {high:g}, expected two finite numbers with 0 < low <= high")


def _require_not_negative(name: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0):
        raise ValueError(f"{name}: found {value:g}, expected a finite number, 0 or more")


def _require_finite(name: str, value: float) -> None:
    if not math.isfinite(value):
        raise ValueError(f"{name}: found {value:g}, expected a finite number")


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
    gravity
        Downwards along the world's z, m/s² for a character 1 m long: the skin of one that is `Surface.size` long
        rests gravity * size / ks lower.
    use_learned
        Whether springs that were learned take the place of painted ones, where there are any.
    scale_learned
        Whether what is set and painted now, over what it was when they were learned, scales them.
    """

    stiffness_range: tuple[float, float] = (250.0, 4000.0)
    damping_ratio: float = 0.25
    damping: float | None = None
    mass_range: tuple[float, float] = (0.25, 4.0)
    gravity: float = 0.0
    use_learned: bool = True
    scale_learned: bool = True

    def __post_init__(self) -> None:
        _require_finite("gravity", self.gravity)
        _require_range("stiffness_range", *self.stiffness_range)
        _require_range("mass_range", *self.mass_range)
        for name in ("damping_ratio", "damping"):
            value = getattr(self, name)
            if value is not None:
                _require_not_negative(name, value)


@dataclass(frozen=True)
class SimulationSettings:
    """Flesh for the finite elements (`elastic.ImplicitEuler`), and for the emulator, that painted values are mapped to.

    Stiffness and gravity are those of a character 1 m long along its longest side (`Surface.size`); for another size the modulus
    is multiplied by the size squared and gravity by the size. A copy of a character in other units then moves alike.

    Parameters
    ----------
    youngs_modulus_range
        Young's modulus (Pa) where the stiffness group is painted 0 and 1; between them the scale is logarithmic.
    density_range
        Density (kg/m³) where the mass group is painted 0 and 1, logarithmic between.
    damping_ratio
        Damping beside backward Euler's own, which no setting takes away: share of critical damping of a layer of flesh
        of middle stiffness, a tenth of the character thick (`flesh.FLESH_THICKNESS`). The finite elements damp faster motion more and
        rigid motion not at all; the emulator damps all motion relative to the reference at one rate.
    gravity
        Downwards along the world's z, m/s². Rigs are usually modelled as gravity has them, so it is 0 as it comes.
    quality
        Of the finite elements: "preview" bounds the work of a frame, "fine" is as good as the eye can tell, "converged" is exact.
    """

    youngs_modulus_range: tuple[float, float] = (2e3, 1e5)
    density_range: tuple[float, float] = (250.0, 4000.0)
    damping_ratio: float = 0.0
    gravity: float = 0.0
    quality: Quality = "fine"

    def __post_init__(self) -> None:
        _require_range("youngs_modulus_range", *self.youngs_modulus_range)
        _require_range("density_range", *self.density_range)
        _require_not_negative("damping_ratio", self.damping_ratio)
        _require_finite("gravity", self.gravity)
        if self.quality not in QUALITIES:
            raise ValueError(f"quality: found {self.quality!r}, expected {', '.join(QUALITIES)}")


@dataclass(frozen=True)
class EmulatorSettings:
    """The emulator; what it moves is the flesh of `SimulationSettings`.

    Parameters
    ----------
    weights
        Weights file; None: those that come with the package.
    corrections
        Newton iterations of the true solver, at most, that start from each prediction. 0: the network alone.
    """

    weights: Path | None = None
    corrections: int = 0

    def __post_init__(self) -> None:
        if self.corrections < 0:
            raise ValueError(f"corrections: found {self.corrections}, expected 0 or more")


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
        _require_not_negative("core_radius", self.core_radius)
        if self.method not in ("voxel", "tetgen"):
            raise ValueError(f"method: found {self.method!r}, expected 'voxel' or 'tetgen'")


@dataclass(frozen=True)
class Settings:
    """All settings of one character's bake.

    Parameters
    ----------
    volume
        See there.
    solver
        "springs"; "implicit-euler": finite elements; or "emulator": the network that has learned them.
    springs, simulation, emulator
        Constants of the springs, of the flesh, and how the network is run.
    amplitude
        How far the motion goes, on any solver (`controls.Amplified`): 0 is the rig alone, 1 what the solver says.
    minimum_stretch
        Inverse skinning never divides by a stretch smaller than this: where the rig flattens the skin, the shape key stays bounded and
        the part of the motion that it cannot show is reported as the residual.
    """

    volume: VolumeSettings = field(default_factory=VolumeSettings)
    solver: SolverName = field(default_factory=default_solver)
    springs: SpringSettings = field(default_factory=SpringSettings)
    simulation: SimulationSettings = field(default_factory=SimulationSettings)
    emulator: EmulatorSettings = field(default_factory=EmulatorSettings)
    amplitude: float = 1.0
    minimum_stretch: float = 0.05

    def __post_init__(self) -> None:
        if self.solver not in SOLVERS:
            raise ValueError(f"solver: found {self.solver!r}, expected {' or '.join(SOLVERS)}")
        _require_not_negative("amplitude", self.amplitude)
        if not (math.isfinite(self.minimum_stretch) and 0 < self.minimum_stretch <= 1):
            raise ValueError(f"minimum_stretch: found {self.minimum_stretch:g}, expected more than 0 and at most 1")
