# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted values as flesh: the material of a character's volume, held by its pins, and the finite elements that move it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.mesh import connected_parts
from followthrough.settings import SimulationSettings
from followthrough.solver import Solver
from followthrough.springs import Springs
from followthrough.volume import Volume

#: Usual thickness of the flesh on the bones, as a share of the character's size. Soft pins and damping are measured by it.
FLESH_THICKNESS = 0.1
#: Flesh hardly changes its volume.
POISSON_RATIO = 0.45
#: Pins weaker than this hold nothing: what smoothing leaves of them.
_LEAST_PIN = 1e-3


@dataclass(frozen=True)
class Flesh:
    """What is painted, as the material of a volume's vertices, whatever moves it.

    Attributes
    ----------
    constrained : (n,) bool
        Vertices that follow the reference exactly: pinned ones, and parts that no pin holds.
    youngs_modulus, density : (n,) float64
        Pa and kg/m³.
    rate : (n,) float64
        How fast a layer of it, of usual thickness on a bone, swings along the bone, radians a second.
    pin_stiffness : (n,) float64
        Of the springs that soft pins are, over the mass, 1/s².
    gravity : tuple of float
        m/s².
    """

    constrained: NDArray[np.bool_]
    youngs_modulus: FloatArray
    density: FloatArray
    rate: FloatArray
    pin_stiffness: FloatArray
    gravity: tuple[float, float, float]


def paint_flesh(volume: Volume, settings: SimulationSettings) -> Flesh:
    """Painted constants of a volume. The rest pose is the rest shape.

    A soft pin p is a spring to the reference that is p / (1 - p) times as stiff as the flesh itself: as a layer on a bone,
    `FLESH_THICKNESS` of the character thick. Of the motion that such flesh would have, 1 - p is left, whatever size, frame rate, mass
    and stiffness are. Parts that no pin holds follow the reference as a whole (`loose_vertices`).

    Raises
    ------
    ValueError
        Where no vertex of the volume is held by a pin.
    """
    loose = loose_vertices(volume)
    if loose.all():
        raise ValueError(
            "pins: found none that holds the flesh, expected some (paint pins where the character follows its bones, or take "
            "springs, which hang on it everywhere)"
        )
    constrained = volume.pinned | loose
    size = volume.surface.size
    unit_modulus = logarithmic(settings.youngs_modulus_range, volume.stiffness)
    density = logarithmic(settings.density_range, volume.mass)
    rate = _flesh_rate(unit_modulus, density)
    soft = np.where(constrained, 0.0, volume.pins)
    return Flesh(
        constrained=constrained,
        youngs_modulus=unit_modulus * size**2,
        density=density,
        rate=rate,
        pin_stiffness=rate**2 * soft / (1.0 - soft),
        gravity=(0.0, 0.0, -settings.gravity * size),
    )


def make_flesh(volume: Volume, settings: SimulationSettings, dt: float) -> Solver:
    """Backward Euler finite elements on a volume, with painted constants (`paint_flesh`).

    Parameters
    ----------
    volume
        The character.
    settings
        What it is made of.
    dt
        Seconds a frame.

    Raises
    ------
    ValueError
        Where no vertex of the volume is held by a pin.
    """
    flesh = paint_flesh(volume, settings)
    if flesh.constrained.all():
        return nothing_to_simulate(flesh, dt)
    return true_solver(volume, flesh, dt, quality=settings.quality, stiffness_damping=_stiffness_damping(settings))


def elastic_body(volume: Volume, flesh: Flesh) -> ElasticBody:
    """A volume of this flesh."""
    return ElasticBody(
        volume.tet_mesh.vertices,
        volume.tet_mesh.tets,
        flesh.youngs_modulus,
        density=flesh.density,
        poisson_ratio=POISSON_RATIO,
    )


def soft_pins(body: ElasticBody, flesh: Flesh) -> FloatArray:
    """Stiffness (n,) of the springs that soft pins are to a body of this flesh, N/m."""
    stiffness: FloatArray = body.lumped_mass * flesh.pin_stiffness
    return stiffness


def true_solver(volume: Volume, flesh: Flesh, dt: float, **options: Any) -> ImplicitEuler:
    """Finite elements of this flesh; options as `ImplicitEuler` has them."""
    body = elastic_body(volume, flesh)
    return ImplicitEuler(
        body,
        flesh.constrained,
        dt,
        gravity=flesh.gravity,
        pin_stiffness=soft_pins(body, flesh),
        **options,
    )


def nothing_to_simulate(flesh: Flesh, dt: float) -> Springs:
    """What moves flesh that is all constrained, as the teeth of a character: springs that are all pinned."""
    ones = np.ones(len(flesh.constrained))
    return Springs(ones, ones, dt, flesh.constrained)


def loose_vertices(volume: Volume) -> NDArray[np.bool_]:
    """Vertices (n,) of those connected parts of a volume that no pin holds, neither hard nor soft."""
    parts = connected_parts(volume.tet_mesh.tets, len(volume.pins))
    strongest = np.zeros(len(parts))
    np.maximum.at(strongest, parts, volume.pins)
    loose: NDArray[np.bool_] = strongest[parts] < _LEAST_PIN
    return loose


def logarithmic(ends: tuple[float, float], painted: FloatArray) -> FloatArray:
    """Painted values from 0 to 1 on a logarithmic scale between two ends."""
    low, high = ends
    values: FloatArray = low ** (1.0 - painted) * high**painted
    return values


def _flesh_rate(unit_modulus: FloatArray, density: FloatArray) -> FloatArray:
    """How fast a layer of flesh of usual thickness on a bone swings along the bone, radians a second.

    A quarter of a shear wave fits into it: pi / 2 sqrt(shear modulus / density) / thickness.
    """
    shear_modulus = unit_modulus / (2.0 * (1.0 + POISSON_RATIO))
    rate: FloatArray = 0.5 * math.pi * np.sqrt(shear_modulus / density) / FLESH_THICKNESS
    return rate


def _stiffness_damping(settings: SimulationSettings) -> float:
    """Rayleigh's beta, s: a damping ratio z at the rate w is 2 z / w."""
    return 2.0 * settings.damping_ratio / middle_rate(settings)


def middle_rate(settings: SimulationSettings) -> float:
    """`Flesh.rate` of middle stiffness and mass."""
    middle = [
        np.asarray(math.sqrt(low * high)) for low, high in (settings.youngs_modulus_range, settings.density_range)
    ]
    return float(_flesh_rate(*middle))
