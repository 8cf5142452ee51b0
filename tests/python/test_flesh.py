# SPDX-License-Identifier: GPL-3.0-or-later
"""Painted values as flesh: what they mean does not depend on size, frame rate or mass."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from flesh_volumes import MIDDLE, bar, held_at_one_end, layer_rate, settled, shaken

from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.flesh import loose_vertices, make_flesh
from followthrough.settings import Settings, SimulationSettings

DT = 1.0 / 24.0
EXACT = SimulationSettings(quality="converged")


def test_paint_is_logarithmic_between_the_ends() -> None:
    volume = held_at_one_end(bar(size=2.0))
    ramp = np.linspace(0.0, 1.0, len(volume.pins))
    volume = dataclasses.replace(volume, stiffness=ramp, mass=ramp[::-1])
    settings = SimulationSettings(
        youngs_modulus_range=(1e3, 1e5),
        density_range=(500.0, 2000.0),
        quality="converged",
        gravity=3.0,
        damping_ratio=0.1,
    )
    body = ElasticBody(
        volume.tet_mesh.vertices,
        volume.tet_mesh.tets,
        4.0 * 10.0 ** (3.0 + 2.0 * ramp),  # twice the size, four times the modulus
        density=500.0 * 4.0 ** ramp[::-1],
    )
    # Damping is measured on flesh of 1e4 Pa and 1000 kg/m3.
    beta = 2.0 * 0.1 / (layer_rate() * np.sqrt(1e4 / MIDDLE))
    expected = ImplicitEuler(body, volume.pinned, DT, gravity=(0, 0, -6.0), stiffness_damping=beta)
    for found, wanted in zip(shaken(make_flesh(volume, settings, DT), volume), shaken(expected, volume), strict=True):
        assert np.abs(found - wanted).max() < 1e-7
    assert np.abs(wanted).max() > 0.01


@pytest.mark.parametrize("settings", [EXACT, dataclasses.replace(EXACT, gravity=9.81, damping_ratio=0.2)])
def test_a_character_100_times_as_large_moves_alike(settings: SimulationSettings) -> None:
    motions = []
    for size in (0.01, 1.0, 100.0):
        volume = held_at_one_end(bar(size, pins=0.1))
        motions.append(shaken(make_flesh(volume, settings, DT), volume))
    for small, middle, large in zip(*motions, strict=True):
        scale = np.abs(middle).max()
        assert np.abs(small - middle).max() < 1e-5 * scale
        assert np.abs(large - middle).max() < 1e-5 * scale
    assert scale > 0.01


def test_a_part_is_as_stiff_as_the_character_that_it_belongs_to() -> None:
    volume = held_at_one_end(bar())
    part = dataclasses.replace(volume, surface=dataclasses.replace(volume.surface, character_size=2.0))
    alone = make_flesh(part, EXACT, DT)
    body = ElasticBody(volume.tet_mesh.vertices, volume.tet_mesh.tets, 4.0 * MIDDLE, density=1000.0)
    for found, wanted in zip(
        shaken(alone, volume), shaken(ImplicitEuler(body, volume.pinned, DT), volume), strict=True
    ):
        assert np.abs(found - wanted).max() < 1e-7


@pytest.mark.parametrize(("size", "frames_a_second", "mass"), [(1.0, 24.0, 0.5), (1.0, 24.0, 0.9), (100.0, 60.0, 0.5)])
def test_a_soft_pin_carries_its_share_of_the_weight(size: float, frames_a_second: float, mass: float) -> None:
    pin = 0.25
    volume = bar(size, pins=pin)
    volume = dataclasses.replace(volume, mass=np.full_like(volume.mass, mass))
    settings = dataclasses.replace(EXACT, gravity=5.0)
    # Springs in proportion to the mass let the bar down as it is: weight over stiffness.
    stiffness = layer_rate(250.0 * 16.0**mass) ** 2 * pin / (1.0 - pin)
    dt = 1.0 / frames_a_second
    found = settled(make_flesh(volume, settings, dt), volume.tet_mesh.vertices, seconds=10.0, dt=dt)
    sag = (found - volume.tet_mesh.vertices) / size
    assert np.abs(sag[:, :2]).max() < 1e-6
    assert sag[:, 2] == pytest.approx(-5.0 / stiffness, rel=1e-3)


def test_a_soft_pin_of_p_leaves_1_minus_p_of_the_motion() -> None:
    """On a layer of flesh of the usual thickness that hangs on a wall by its weight."""
    settings = dataclasses.replace(EXACT, gravity=1.0)

    def sag(pin: float) -> float:
        volume = bar(pins=pin, sides=(0.1, 0.2, 1.0), cells=20)
        rest = volume.tet_mesh.vertices
        volume = dataclasses.replace(volume, pins=np.where(rest[:, 1] < 0.101, 1.0, pin))
        long_frames = make_flesh(volume, settings, dt=1.0)  # so that backward Euler damps all motion
        middle = np.abs(rest[:, 2] - 0.5) < 0.2
        return float((rest - settled(long_frames, rest, 12.0, dt=1.0))[middle, 2].max())

    free = sag(0.0)
    for pin in (0.1, 0.25, 0.5, 0.75, 0.9):
        assert sag(pin) / free == pytest.approx(1.0 - pin, abs=0.04)


def test_a_part_that_no_pin_holds_follows_the_reference() -> None:
    volume = bar(parts=2)
    lower = volume.tet_mesh.vertices[:, 1] < 0.4
    volume = dataclasses.replace(volume, pins=np.where(lower & (volume.tet_mesh.vertices[:, 0] < 0.05), 1.0, 0.0))
    assert np.array_equal(loose_vertices(volume), ~lower)
    displacement = shaken(make_flesh(volume, EXACT, DT), volume)[-1]
    assert not displacement[~lower].any()
    assert np.abs(displacement[lower]).max() > 0.01
    # A soft pin holds as well.
    soft = dataclasses.replace(volume, pins=np.where(lower, volume.pins, 0.3))
    assert not loose_vertices(soft).any()


def test_flesh_that_nothing_holds_is_refused() -> None:
    with pytest.raises(ValueError, match=r"pins: found none.*paint pins"):
        make_flesh(bar(), EXACT, DT)


def test_where_all_is_pinned_nothing_moves() -> None:
    volume = bar(pins=1.0)
    assert not np.any(shaken(make_flesh(volume, EXACT, DT), volume))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"youngs_modulus_range": (2.0, 1.0)}, "youngs_modulus_range: found 2 to 1, expected .* low <= high"),
        ({"youngs_modulus_range": (0.0, 1.0)}, "youngs_modulus_range"),
        ({"density_range": (1.0, float("inf"))}, "density_range"),
        ({"damping_ratio": -0.1}, "damping_ratio: found -0.1"),
        ({"gravity": float("nan")}, "gravity"),
        ({"quality": "best"}, "quality: found 'best', expected preview, fine, converged"),
    ],
)
def test_nonsense_is_refused_by_name(values: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        SimulationSettings(**values)  # type: ignore[arg-type]


def test_an_unknown_solver_is_refused() -> None:
    with pytest.raises(ValueError, match="solver: found 'magic', expected springs or emulator or implicit-euler"):
        Settings(solver="magic")  # type: ignore[arg-type]
