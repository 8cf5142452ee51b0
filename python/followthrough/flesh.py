# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted values as flesh: the finite elements of a character's volume, held by its pins."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from followthrough.character import FloatArray
from followthrough.elastic import ElasticBody, ImplicitEuler
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


def make_flesh(volume: Volume, settings: SimulationSettings, dt: float) -> Solver:
    """Backward Euler finite elements on a volume, with painted constants. The rest pose is the rest shape.

    Vertices that are pinned follow the reference exactly. A soft pin p is a spring to the reference that is p / (1 - p) times as
    stiff as the flesh itself: as a layer on a bone, `FLESH_THICKNESS` of the character thick. Of the motion that such flesh
    would have, 1 - p is left, whatever size, frame rate, mass and stiffness are. Parts that no pin holds follow the reference
    as a whole (`loose_vertices`).

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
    loose = loose_vertices(volume)
    if loose.all():
        raise ValueError(
            "pins: found none that holds the flesh, expected some (paint pins where the character follows its bones)"
        )
    constrained = volume.pinned | loose
    if constrained.all():
        # Nothing is left to simulate, as with the teeth of a character: springs that are all pinned.
        return Springs(np.ones(len(constrained)), np.ones(len(constrained)), dt, constrained)
    size = volume.surface.size
    unit_modulus = _logarithmic(settings.youngs_modulus_range, volume.stiffness)
    density = _logarithmic(settings.density_range, volume.mass)
    body = ElasticBody(
        volume.tet_mesh.vertices,
        volume.tet_mesh.tets,
        unit_modulus * size**2,
        density=density,
        poisson_ratio=POISSON_RATIO,
    )
    soft = np.where(constrained, 0.0, volume.pins)
    return ImplicitEuler(
        body,
        constrained,
        dt,
        quality=settings.quality,
        gravity=(0.0, 0.0, -settings.gravity * size),
        stiffness_damping=_stiffness_damping(settings),
        pin_stiffness=body.lumped_mass * _flesh_rate(unit_modulus, density) ** 2 * soft / (1.0 - soft),
    )


def loose_vertices(volume: Volume) -> NDArray[np.bool_]:
    """Vertices (n,) of those connected parts of a volume that no pin holds, neither hard nor soft."""
    parts = _connected_parts(volume.tet_mesh.tets, len(volume.pins))
    strongest = np.zeros(len(parts))
    np.maximum.at(strongest, parts, volume.pins)
    loose: NDArray[np.bool_] = strongest[parts] < _LEAST_PIN
    return loose


def _connected_parts(tets: NDArray[np.int32], vertex_count: int) -> NDArray[np.intp]:
    """Lowest vertex (n,) of the connected part that each vertex is in."""
    lowest: NDArray[np.intp] = np.arange(vertex_count)
    while True:
        before = lowest.copy()
        np.minimum.at(lowest, tets, lowest[tets].min(axis=1, keepdims=True))
        lowest = lowest[lowest]
        if np.array_equal(lowest, before):
            return lowest


def _logarithmic(ends: tuple[float, float], painted: FloatArray) -> FloatArray:
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
    middle = [
        np.asarray(math.sqrt(low * high)) for low, high in (settings.youngs_modulus_range, settings.density_range)
    ]
    return 2.0 * settings.damping_ratio / float(_flesh_rate(*middle))
