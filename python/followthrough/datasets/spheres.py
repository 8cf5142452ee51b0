# SPDX-License-Identifier: GPL-3.0-or-later
"""The published training data, rebuilt: a sphere shaken by its core, at seven stiffnesses [DE 3.3]."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from followthrough import mesh
from followthrough.character import FloatArray, IntArray
from followthrough.datasets.motions import PUBLISHED_FRAMES, core_motion
from followthrough.datasets.recipes import Item, Setting, checked_seed, random_numbers
from followthrough.datasets.surfaces import ellipsoid
from followthrough.sequences import Sequence

#: Young's moduli of the published data, Pa.
PUBLISHED_STIFFNESSES = (5e6, 2.5e6, 1e6, 5e5, 2.5e5, 1e5, 5e4)
#: Seconds a frame.
FRAME_TIME = math.sqrt(0.001)
#: Cubes along an edge of the unit of length: the radius is 1, an edge 0.2.
_CELLS_A_RADIUS = 5


@dataclass(frozen=True, eq=False)
class SphereVolume:
    """The training sphere.

    Attributes
    ----------
    vertices : (1015, 3) float64
        m, radius 1.
    tets : (4320, 4) int32
    core : (1015,) bool
        The 3 x 3 beam along y that is moved, 99 vertices.
    """

    vertices: FloatArray
    tets: IntArray
    core: NDArray[np.bool_]


@lru_cache(maxsize=1)
def sphere_volume() -> SphereVolume:
    """Cubes of 0.2 m that a ball of 1 m fills, cut in tets as any character's volume is."""
    surface = ellipsoid((0, 0, 0), (1, 1, 1), rings=60, sides=120)
    volume = mesh.tetrahedralize(surface.vertices, surface.triangles, cell_size=1 / _CELLS_A_RADIUS)
    grid = np.rint(volume.vertices * _CELLS_A_RADIUS)
    core = (np.abs(grid[:, 0]) <= 1) & (np.abs(grid[:, 2]) <= 1)
    return SphereVolume(grid / _CELLS_A_RADIUS, volume.tets, core)


def stiffness_label(youngs_modulus: float) -> str:
    """A modulus for a file name: 2500000 is "2.5e6Pa"."""
    digits, exponent = f"{youngs_modulus:.15e}".split("e")
    return f"{float(digits):.15g}e{int(exponent)}Pa"


@dataclass(frozen=True)
class SphereRecipe:
    """Every motion of the sphere's core at every stiffness.

    Parameters
    ----------
    seed
        0 or more.
    stiffnesses
        Young's moduli, Pa.
    frames
        Of a motion.

    Raises
    ------
    ValueError
        On a negative seed, moduli that are not positive or come twice, or fewer than 20 frames.
    """

    seed: int
    stiffnesses: tuple[float, ...] = PUBLISHED_STIFFNESSES
    frames: int = PUBLISHED_FRAMES
    kind = "sphere"
    version = 1

    def __post_init__(self) -> None:
        checked_seed(self.seed)
        if not self.stiffnesses:
            raise ValueError("stiffnesses: found none, expected at least one Young's modulus")
        for modulus in self.stiffnesses:
            if not (math.isfinite(modulus) and modulus > 0):
                raise ValueError(f"stiffnesses: found {modulus:g}, expected more than 0 Pa")
        if len({stiffness_label(modulus) for modulus in self.stiffnesses}) < len(self.stiffnesses):
            raise ValueError("stiffnesses: found one twice, expected each once")
        if self.frames < 20:
            raise ValueError(f"frames: found {self.frames}, expected 20 or more")

    def settings(self) -> dict[str, Setting]:
        """Stiffnesses and number of frames."""
        return {"stiffnesses": list(self.stiffnesses), "frames": self.frames}

    def items(self, motions: int) -> list[Item]:
        """A file a motion and stiffness."""
        return [
            Item(
                f"motion-{motion:04d}-{stiffness_label(modulus)}.npz",
                motion,
                self.frames,
                {"youngs_modulus": float(modulus)},
            )
            for motion in range(motions)
            for modulus in self.stiffnesses
        ]

    def make(self, item: Item) -> Sequence:
        """The sphere in one motion; free vertices' reference moves rigidly with the core."""
        volume = sphere_volume()
        motion = core_motion(random_numbers(self.kind, self.seed, item.motion), self.frames)
        modulus = item.facts["youngs_modulus"]
        assert isinstance(modulus, float)
        return Sequence(
            rest_positions=volume.vertices,
            tets=volume.tets,
            constrained=volume.core,
            youngs_modulus=np.full(len(volume.vertices), modulus),
            dt=FRAME_TIME,
            reference=motion(volume.vertices),
            density=1000.0,
        )
