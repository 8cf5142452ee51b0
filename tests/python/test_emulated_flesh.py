# SPDX-License-Identifier: GPL-3.0-or-later
"""The emulator on painted flesh: the simulation's material, pins and damping, and what it says of flesh that it has not learned."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from flesh_volumes import BOX, TRIANGLES, bar, held_at_one_end, settled, shaken

from followthrough import emulator_weights
from followthrough.character import Paint, Surface
from followthrough.controls import SoftPins
from followthrough.emulated_flesh import caution, kept_share, load_weights, make_emulated_flesh
from followthrough.emulator import Emulator
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.flesh import make_flesh, paint_flesh, true_solver
from followthrough.secondary_motion import make_solver
from followthrough.settings import EmulatorSettings, Settings, SimulationSettings, VolumeSettings

sys.path.insert(0, str(Path(__file__).parent))
from plain_network import random_parameters

DT = 1.0 / 24.0
SMALL = {"inertia": (8, 8), "force": (12, 8), "displacement": (16,)}
FLESH = SimulationSettings()


@pytest.fixture
def weights(tmp_path: Path) -> EmulatorSettings:
    path = tmp_path / "network.npz"
    EmulatorWeights(random_parameters(0, **SMALL), TrainedOn(stiffness_range=(0.5, 150.0))).save(path)
    return EmulatorSettings(weights=path)


def test_it_moves_the_flesh_that_is_painted(weights: EmulatorSettings) -> None:
    volume = held_at_one_end(bar(size=2.0))
    ramp = np.linspace(0.0, 1.0, len(volume.pins))
    volume = dataclasses.replace(volume, stiffness=ramp, mass=ramp[::-1])
    simulation = SimulationSettings(youngs_modulus_range=(1e4, 1e5), density_range=(500.0, 2000.0), gravity=3.0)
    expected = Emulator(
        volume.tet_mesh.vertices,
        volume.tet_mesh.tets,
        volume.pinned,
        4.0 * 10.0 ** (4.0 + ramp),
        500.0 * 4.0 ** ramp[::-1],
        DT,
        load_weights(weights),
        gravity=(0.0, 0.0, -6.0),
    )
    assert expected.edge_length == pytest.approx(0.2)  # what `caution` takes it for: the longest side over the cells
    found = make_emulated_flesh(volume, simulation, weights, DT)
    for one, other in zip(shaken(found, volume), shaken(expected, volume), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-9)
    assert np.abs(other).max() > 0.01


def test_a_character_100_times_as_large_moves_alike(weights: EmulatorSettings) -> None:
    simulation = SimulationSettings(gravity=5.0, damping_ratio=0.2)
    for corrections in (0, 2):
        settings = dataclasses.replace(weights, corrections=corrections)
        motions = []
        for size in (1.0, 100.0):
            volume = held_at_one_end(bar(size, pins=0.2))
            motions.append(shaken(make_emulated_flesh(volume, simulation, settings, DT), volume))
        for small, large in zip(*motions, strict=True):
            assert np.abs(large - small).max() < 2e-4 * np.abs(small).max()


def test_corrections_lead_to_the_simulation_with_its_gravity_and_pins(weights: EmulatorSettings) -> None:
    volume = held_at_one_end(bar(pins=0.15))
    simulation = dataclasses.replace(FLESH, gravity=5.0, quality="converged")
    true = shaken(make_flesh(volume, simulation, DT), volume)
    errors = []
    for corrections in (0, 1, 2, 30):
        settings = dataclasses.replace(weights, corrections=corrections)
        motion = shaken(make_emulated_flesh(volume, simulation, settings, DT), volume)
        errors.append(max(np.abs(one - other).max() for one, other in zip(motion, true, strict=True)))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.02 * max(np.abs(step).max() for step in true)


@pytest.mark.parametrize("gravity", [0.0, 5.0])
def test_what_ships_is_the_simulation_soft_pins_and_all(gravity: float) -> None:
    """Also where they change along the flesh, which does not swing as one layer then."""
    volume = held_at_one_end(bar())
    along = volume.tet_mesh.vertices[:, 0]
    soft = 0.9 * np.sin(np.pi * along / along.max()) ** 2
    volume = dataclasses.replace(volume, pins=np.maximum(volume.pins, soft))
    simulation = dataclasses.replace(FLESH, gravity=gravity, quality="converged")
    true = np.array(shaken(make_flesh(volume, simulation, DT), volume))
    found = np.array(shaken(make_emulated_flesh(volume, simulation, EmulatorSettings(), DT), volume))
    share = float(np.sqrt(np.mean((found - true) ** 2) / np.mean(true**2)))
    print(f"gravity {gravity:g}: off by {100 * share:.2g} % of the motion")
    assert np.abs(true).max() > 0.01
    assert np.abs(found - true).max() < 0.02 * np.abs(true).max()


@pytest.mark.parametrize("dt", [1.0, 1.0 / 24.0])
def test_a_soft_pin_of_p_leaves_1_minus_p_of_the_motion_whatever_the_frame_length(dt: float) -> None:
    """Of a layer of flesh that hangs on a wall, moved by a solver that knows nothing of pins."""
    simulation = SimulationSettings(gravity=1.0)

    def sag(pin: float) -> float:
        volume = bar(pins=pin, sides=(0.1, 0.2, 1.0), cells=20)
        rest = volume.tet_mesh.vertices
        volume = dataclasses.replace(volume, pins=np.where(rest[:, 1] < 0.101, 1.0, pin))
        flesh = paint_flesh(volume, simulation)
        loose = dataclasses.replace(flesh, pin_stiffness=np.zeros_like(flesh.pin_stiffness))
        solver = SoftPins(true_solver(volume, loose, dt, quality="fine"), kept_share(flesh, dt))
        middle = np.abs(rest[:, 2] - 0.5) < 0.2
        return float((rest - settled(solver, rest, max(12.0 * dt, 1.5), dt=dt))[middle, 2].max())

    free = sag(0.0)
    for pin in (0.25, 0.5, 0.75):
        assert sag(pin) / free == pytest.approx(1.0 - pin, abs=0.07)


def test_damping_takes_the_swing_out(weights: EmulatorSettings) -> None:
    volume = held_at_one_end(bar())
    sizes = []
    for ratio in (0.0, 0.3, 1.0):
        simulation = dataclasses.replace(FLESH, damping_ratio=ratio)
        exact = dataclasses.replace(weights, corrections=20)
        motion = shaken(make_emulated_flesh(volume, simulation, exact, DT), volume, frames=24)
        sizes.append(float(np.sqrt(np.mean(np.square(motion)))))
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[-1] < 0.8 * sizes[0]


def test_what_nothing_holds_is_refused_and_what_is_all_held_stays(weights: EmulatorSettings) -> None:
    with pytest.raises(ValueError, match=r"pins: found none.*paint pins"):
        make_emulated_flesh(bar(), FLESH, weights, DT)
    volume = bar(pins=1.0)
    assert not np.any(shaken(make_emulated_flesh(volume, FLESH, weights, DT), volume))


def test_weights_that_are_missing_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    volume = held_at_one_end(bar())
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "emulator.npz")
    with pytest.raises(ValueError, match=r"brings none for the emulator.*Simulation"):
        make_emulated_flesh(volume, FLESH, EmulatorSettings(), DT)
    with pytest.raises(ValueError, match="found no such file"):
        make_emulated_flesh(volume, FLESH, EmulatorSettings(weights=tmp_path / "mine.npz"), DT)
    EmulatorWeights(random_parameters(0, **SMALL)).save(emulator_weights.SHIPPED)
    assert shaken(make_emulated_flesh(volume, FLESH, EmulatorSettings(), DT), volume)
    # A file that is written anew is read anew.
    EmulatorWeights(random_parameters(0, **SMALL), TrainedOn(stiffness_range=(2.0, 3.0))).save(emulator_weights.SHIPPED)
    assert load_weights(EmulatorSettings()).trained_on.stiffness_range == (2.0, 3.0)


def test_every_solver_has_an_amplitude(weights: EmulatorSettings) -> None:
    volume = held_at_one_end(bar())
    for solver in ("springs", "emulator", "implicit-euler"):
        settings = Settings(solver=solver, emulator=weights)
        plain = shaken(make_solver(volume, settings, DT), volume)
        for amplitude in (0.0, 1.7):
            scaled = shaken(make_solver(volume, dataclasses.replace(settings, amplitude=amplitude), DT), volume)
            for one, other in zip(scaled, plain, strict=True):
                np.testing.assert_allclose(one, amplitude * other, rtol=0, atol=1e-13)
                assert amplitude or not one.any()
    with pytest.raises(ValueError, match="amplitude: found -1"):
        Settings(amplitude=-1.0)
    with pytest.raises(ValueError, match="corrections: found -1"):
        EmulatorSettings(corrections=-1)


def painted_box(size: float = 1.0) -> tuple[Surface, Paint]:
    surface = Surface(size * BOX, TRIANGLES)
    return surface, Paint(np.linspace(0.0, 1.0, 8), np.full(8, 0.5), np.array([1.0, 0, 0, 0, 0, 0, 0, 0]))


def asked(settings: EmulatorSettings, moduli: tuple[float, float], cells: int = 25, size: float = 1.0) -> str:
    motion = Settings(
        volume=VolumeSettings(cells=cells),
        solver="emulator",
        simulation=SimulationSettings(youngs_modulus_range=moduli),
        emulator=settings,
    )
    return caution(*painted_box(size), motion, DT)


@pytest.mark.parametrize("size", [0.01, 1.0, 100.0])
def test_flesh_beyond_what_was_learned_is_counted_and_the_advice_helps(weights: EmulatorSettings, size: float) -> None:
    # s = E dt² cells² / density: 25 cells at 24 frames a second make 1e3 Pa 1.085.
    assert asked(weights, (2e3, 1e5), size=size) == ""
    said = asked(weights, (100.0, 1e4), size=size)
    assert said.startswith("2 of 7 vertices are softer than the emulator has learned")
    assert "take Simulation" in said
    (softest,), (cells,) = re.findall(r"Softest to ([\d.]+) kPa", said), re.findall(r"Cells to (\d+) or more", said)
    assert asked(weights, (1000.0 * float(softest), 1e4), size=size) == ""
    assert asked(weights, (980.0 * float(softest), 1e4), size=size)
    assert asked(weights, (100.0, 1e4), cells=int(cells), size=size) == ""
    assert "softer" in asked(weights, (100.0, 1e4), cells=int(cells) - 1, size=size)
    # More cells would make what is stiff already too stiff.
    assert "Cells" not in asked(weights, (100.0, 1e5), size=size)
    said = asked(weights, (2e3, 1e6), size=size)
    assert re.match(r"\d of 7 vertices are stiffer than", said)
    (stiffest,), (cells,) = re.findall(r"Stiffest to ([\d.]+) kPa", said), re.findall(r"Cells to (\d+) or fewer", said)
    assert asked(weights, (2e3, 1000.0 * float(stiffest)), size=size) == ""
    assert asked(weights, (2e3, 1020.0 * float(stiffest)), size=size)
    assert asked(weights, (2e3, 1e6), cells=int(cells), size=size) == ""
    assert "stiffer" in asked(weights, (2e3, 1e6), cells=int(cells) + 1, size=size)


def test_flesh_that_is_too_soft_here_and_too_stiff_there_can_only_be_painted_otherwise(
    weights: EmulatorSettings,
) -> None:
    said = asked(weights, (10.0, 1e6))
    assert re.search(r"\d of 7 vertices are softer and \d of 7 vertices are stiffer than", said)
    assert "Softest to" in said and "Stiffest to" in said and "Cells" not in said


def test_volumes_without_cubes_are_measured_by_their_tets(weights: EmulatorSettings) -> None:
    surface, paint = painted_box()
    tet_mesh = bar(sides=(1.0, 1.0, 1.0), cells=5).tet_mesh
    settings = Settings(
        volume=VolumeSettings(method="tetgen", cells=1),
        solver="emulator",
        simulation=SimulationSettings(youngs_modulus_range=(2e3, 1e4)),
        emulator=weights,
    )
    cubes = dataclasses.replace(settings, volume=VolumeSettings(cells=5))
    said = caution(surface, paint, settings, DT, tet_mesh)
    assert "softer" in said and "Cells" not in said
    assert said == caution(surface, paint, cubes, DT).replace("set Cells to 11 or more, or ", "")
    assert caution(surface, paint, settings, DT) == ""  # before there is a volume


def test_a_mesh_without_extent_is_left_to_others_to_refuse(weights: EmulatorSettings) -> None:
    surface, paint = painted_box(size=0.0)
    settings = Settings(solver="emulator", emulator=weights)
    assert caution(surface, paint, settings, DT) == ""


def test_other_solvers_know_no_such_limit(weights: EmulatorSettings) -> None:
    for solver in ("springs", "implicit-euler"):
        settings = Settings(solver=solver, simulation=SimulationSettings(youngs_modulus_range=(1.0, 1e9)))
        assert caution(*painted_box(), settings, DT) == ""
