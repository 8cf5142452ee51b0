# SPDX-License-Identifier: GPL-3.0-or-later
"""What the artist sets is what the library is told."""

import math
from types import ModuleType

import bpy
import pytest

from followthrough.settings import SimulationSettings, SpringSettings, VolumeSettings


def test_untouched_settings_are_the_librarys_own(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.followthrough.property_unset("cells")
    settings = addon.properties.bake_settings.object_settings(painted)
    assert settings.motion.volume == VolumeSettings()
    assert settings.motion.springs.stiffness_range == pytest.approx(SpringSettings().stiffness_range, rel=1e-5)
    assert settings.motion.springs.damping_ratio == pytest.approx(SpringSettings().damping_ratio)
    assert settings.motion.solver == "springs"
    simulation, usual = settings.motion.simulation, SimulationSettings()
    assert simulation.youngs_modulus_range == pytest.approx(usual.youngs_modulus_range, rel=1e-5)
    assert (simulation.damping_ratio, simulation.gravity) == (usual.damping_ratio, usual.gravity)
    assert simulation.quality == usual.quality


def test_the_simulation_is_told_what_is_set(addon: ModuleType, painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.solver, settings.quality = "implicit-euler", "converged"
    settings.modulus_soft, settings.modulus_stiff = 3.0, 70.0
    settings.simulation_damping, settings.gravity = 0.5, 0.5
    motion = addon.properties.bake_settings.object_settings(painted).motion
    assert motion.solver == "implicit-euler"
    assert motion.simulation == SimulationSettings(
        youngs_modulus_range=(3000.0, 70000.0), damping_ratio=0.5, gravity=4.905, quality="converged"
    )


def test_hertz_become_spring_stiffness(addon: ModuleType, painted: bpy.types.Object) -> None:
    painted.followthrough.frequency_soft, painted.followthrough.frequency_stiff = 2.0, 5.0
    springs = addon.properties.bake_settings.object_settings(painted).motion.springs
    # A free spring of this stiffness swings so often in a second.
    frequencies = [math.sqrt(stiffness) / (2.0 * math.pi) for stiffness in springs.stiffness_range]
    assert frequencies == pytest.approx([2.0, 5.0], rel=1e-6)


def test_softest_stays_below_stiffest(painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.frequency_soft = 30.0
    assert settings.frequency_stiff == pytest.approx(30.0)
    settings.frequency_stiff = 1.0
    assert settings.frequency_soft == pytest.approx(1.0)
    settings.modulus_soft = 400.0
    assert settings.modulus_stiff == pytest.approx(400.0)
    settings.modulus_stiff = 0.5
    assert settings.modulus_soft == pytest.approx(0.5)


def test_first_frame_stays_before_the_last(painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.frame_start = 500
    assert settings.frame_end == 500
    settings.frame_end = 20
    assert settings.frame_start == 20


def test_frame_ranges(addon: ModuleType, painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    frames = addon.properties.bake_settings.frame_range
    settings.preroll, settings.cycles = 7, 3
    assert (frames(painted).start, frames(painted).end) == (None, None)
    assert (frames(painted).preroll, frames(painted).cycles) == (7, 0)
    settings.frame_range, settings.frame_start, settings.frame_end = "CUSTOM", 4, 9
    settings.use_loop = True
    assert (frames(painted).start, frames(painted).end) == (4, 9)
    assert (frames(painted).preroll, frames(painted).cycles) == (0, 3)


def test_every_pin_group_is_passed_with_its_strength(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.add_pin_group()
    painted.followthrough.pin_groups[1].strength = 0.5
    pins = addon.properties.bake_settings.object_settings(painted).groups.pins
    assert [(pin.name, pin.strength) for pin in pins] == [
        ("Followthrough Pins", 1.0),
        ("Followthrough Pins.001", 0.5),
    ]


@pytest.mark.parametrize("preset", ["BELLY", "EARS", "TAIL", "JOWLS", "MUSCLE"])
def test_presets(addon: ModuleType, painted: bpy.types.Object, preset: str) -> None:
    wanted = addon.painting.presets.PRESETS[preset]
    settings = painted.followthrough
    for start in ((0.1, 0.2), (50.0, 60.0)):
        settings.frequency_stiff = settings.modulus_stiff = 100.0
        settings.frequency_soft, settings.frequency_stiff = start
        settings.modulus_soft, settings.modulus_stiff = start
        assert bpy.ops.followthrough.apply_preset(preset=preset) == {"FINISHED"}
        assert (settings.frequency_soft, settings.frequency_stiff) == pytest.approx(wanted.frequencies)
        assert settings.damping_ratio == pytest.approx(wanted.damping_ratio)
        assert (settings.modulus_soft, settings.modulus_stiff) == pytest.approx(wanted.moduli)
        assert settings.simulation_damping == pytest.approx(wanted.simulation_damping)
