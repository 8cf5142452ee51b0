# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator on a character: the flesh that is painted, moved by the network, and where that is more than it has learned."""

from __future__ import annotations

import functools
import math
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from followthrough import emulator_weights
from followthrough.character import FloatArray, Paint, Surface
from followthrough.controls import RelativeDamping, SoftPins
from followthrough.elastic import PredictorCorrector
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights
from followthrough.flesh import (
    Flesh,
    elastic_body,
    logarithmic,
    middle_rate,
    nothing_to_simulate,
    paint_flesh,
    soft_pins,
    true_solver,
)
from followthrough.mesh import TetMesh
from followthrough.settings import EmulatorSettings, Settings, SimulationSettings
from followthrough.solver import Solver
from followthrough.volume import HARD_PIN, Volume


def make_emulated_flesh(
    volume: Volume, simulation: SimulationSettings, settings: EmulatorSettings, dt: float
) -> Solver:
    """The emulator on a volume, with the painted constants of simulated flesh (`flesh.paint_flesh`).

    Soft pins are springs of the same stiffness as in the simulation; what the paper's network moves hangs on them after each step
    (`controls.SoftPins`). Damping is that of the motion relative to the reference, at the rate at which the simulation's damping is
    measured. Corrections solve the same equations.

    Parameters
    ----------
    volume
        The character.
    simulation
        What it is made of.
    settings
        Weights and corrections.
    dt
        Seconds a frame.

    Raises
    ------
    ValueError
        Where no vertex of the volume is held by a pin, or there are no weights.
    """
    flesh = paint_flesh(volume, simulation)
    weights = load_weights(settings)
    if flesh.constrained.all():
        return nothing_to_simulate(flesh, dt)
    pinned_softly = flesh.pin_stiffness.any()
    solves_pins = pinned_softly and weights.newton is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # `caution` says it in the artist's words
        solver: Solver = Emulator(
            volume.tet_mesh.vertices,
            volume.tet_mesh.tets,
            flesh.constrained,
            flesh.youngs_modulus,
            flesh.density,
            dt,
            weights,
            gravity=flesh.gravity,
            pin_stiffness=soft_pins(elastic_body(volume, flesh), flesh) if solves_pins else None,
        )
    if pinned_softly and not solves_pins:
        solver = SoftPins(solver, kept_share(flesh, dt))
    if settings.corrections:
        solver = PredictorCorrector(
            solver, true_solver(volume, flesh, dt, quality="fine", most_iterations=settings.corrections)
        )
    if simulation.damping_ratio:
        solver = RelativeDamping(solver, 2.0 * simulation.damping_ratio * middle_rate(simulation), dt)
    return solver


def kept_share(flesh: Flesh, dt: float) -> FloatArray:
    """What soft pins leave of a displacement in each frame, (n,): those of the flesh as springs, for `controls.SoftPins`."""
    share: FloatArray = 1.0 / (1.0 + dt**2 * flesh.pin_stiffness / (1.0 + (dt * flesh.rate) ** 2))
    return share


def load_weights(settings: EmulatorSettings) -> EmulatorWeights:
    """The weights that are asked for; a file is read once as long as it does not change.

    Raises
    ------
    ValueError
        Where there are none, or the file holds something else.
    """
    path = emulator_weights.SHIPPED if settings.weights is None else settings.weights
    try:
        status = path.stat()
    except OSError:
        return EmulatorWeights.shipped() if settings.weights is None else EmulatorWeights.load(path)
    return _read(path, status.st_mtime_ns, status.st_size)


@functools.lru_cache(maxsize=4)
def _read(path: Path, _changed: int, _size: int) -> EmulatorWeights:
    return EmulatorWeights.load(path)


@dataclass(frozen=True)
class Reach:
    """How much of a character's skin is within the stiffness that a network was trained on.

    Attributes
    ----------
    softer, stiffer, free : int
        Vertices below and above the range, and all that are not pinned.
    cells : tuple of int
        Fewest and most cells that bring all of them into it; the fewest may be more than the most.
    softest, stiffest : float
        The Young's moduli (Pa) of paint 0 and 1 that do so as well; infinite and 0 where none does.
    """

    softer: int
    stiffer: int
    free: int
    cells: tuple[int, int]
    softest: float
    stiffest: float


def reach(
    surface: Surface, paint: Paint, settings: Settings, dt: float, edge: float, trained: tuple[float, float]
) -> Reach:
    """Compare the painted skin's dimensionless stiffness E dt² / (density edge²) with a trained range."""
    simulation, cells = settings.simulation, settings.volume.cells
    free = paint.pins < HARD_PIN
    stiffness = np.clip(paint.stiffness[free], 0.0, 1.0)
    modulus = logarithmic(simulation.youngs_modulus_range, stiffness) * surface.size**2
    density = logarithmic(simulation.density_range, np.clip(paint.mass[free], 0.0, 1.0))
    found = modulus / density * (dt / edge) ** 2
    low, high = trained
    softer, stiffer = found < low * (1.0 - 1e-6), found > high * (1.0 + 1e-6)
    fewest, most = 1, 10**6
    if free.any():
        fewest = math.ceil(cells * math.sqrt(low / found.min()) * (1.0 - 1e-9))
        most = math.floor(cells * math.sqrt(high / found.max()) * (1.0 + 1e-9))
    soft, stiff = simulation.youngs_modulus_range
    return Reach(
        softer=int(softer.sum()),
        stiffer=int(stiffer.sum()),
        free=int(free.sum()),
        cells=(fewest, most),
        softest=_new_end(soft, low / found[softer], 1.0 - stiffness[softer]),
        stiffest=_new_end(stiff, high / found[stiffer], stiffness[stiffer]),
    )


def _new_end(end: float, factors: FloatArray, shares: FloatArray) -> float:
    """Modulus of an end of the scale that multiplies vertices by these factors, to which it contributes these shares of logarithms."""
    if not len(factors):
        return end
    with np.errstate(divide="ignore", over="ignore"):
        logarithms = np.log(factors) / np.maximum(shares, 1e-300)
        return float(end * np.exp(logarithms[np.abs(logarithms).argmax()]))


def caution(surface: Surface, paint: Paint, settings: Settings, dt: float, tet_mesh: TetMesh | None = None) -> str:
    """A sentence for the artist where the emulator is asked for flesh that its network has not learned, with what to change; or none.

    It takes the painted skin alone, so it can be said before anything is made for a bake. Only volumes that are not made of cubes
    have to be there to be measured.

    Raises
    ------
    ValueError
        Where there are no weights.
    """
    if settings.solver != "emulator":
        return ""
    trained = load_weights(settings.emulator).trained_on.stiffness_range
    made_of_cubes = settings.volume.method == "voxel"
    if made_of_cubes:
        edge = float(np.ptp(surface.rest_positions @ surface.object_scale.T, axis=0).max()) / settings.volume.cells
    else:
        edge = 0.0 if tet_mesh is None else _cube_edge(tet_mesh)
    if not edge > 0.0:
        return ""
    found = reach(surface, paint, settings, dt, edge, trained)
    fewest, most = found.cells if made_of_cubes else (1, 0)
    ways = []
    if found.softer:
        if found.softest <= settings.simulation.youngs_modulus_range[1]:
            ways.append(f"Softest to {_upwards(found.softest / 1000.0)} kPa or more")
        if fewest <= most:
            ways.append(f"Cells to {fewest} or more")
    if found.stiffer:
        if found.stiffest >= settings.simulation.youngs_modulus_range[0]:
            ways.append(f"Stiffest to {_downwards(found.stiffest / 1000.0)} kPa or less")
        if fewest <= most:
            ways.append(f"Cells to {most} or fewer")
    counts = [
        f"{count} of {found.free} vertices are {what}"
        for count, what in ((found.softer, "softer"), (found.stiffer, "stiffer"))
        if count
    ]
    if not counts:
        return ""
    change = " or ".join(ways) if not (found.softer and found.stiffer) else ", ".join(ways)
    advice = f"set {change}, or " if change else ""
    return f"{' and '.join(counts)} than the emulator has learned, and may move wrongly: {advice}take Simulation"


def _cube_edge(tet_mesh: TetMesh) -> float:
    """Edge of a cube of six tets with the median tet's volume, as the emulator measures tets."""
    corners = tet_mesh.vertices[tet_mesh.tets]
    volumes = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6.0
    return float(np.cbrt(6.0 * np.median(volumes)))


def _upwards(value: float) -> str:
    """Three digits, rounded up."""
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.ceil(value / step * (1.0 - 1e-9)) * step:.4g}"


def _downwards(value: float) -> str:
    step = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.floor(value / step * (1.0 + 1e-9)) * step:.4g}"
