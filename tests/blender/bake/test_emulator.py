# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake with the emulator, and the controls that every solver has."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough import emulator_weights
from followthrough.blender import Bake, ObjectSettings, caution_before_bake, write_group
from followthrough.cli import main
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.settings import EmulatorSettings, Settings, SimulationSettings, SpringSettings, VolumeSettings


def motion(weights, solver="emulator", corrections=0, amplitude=1.0, **simulation):
    return Settings(
        volume=VolumeSettings(cells=8, core_radius=0.0),
        solver=solver,
        springs=SpringSettings(gravity=simulation.get("gravity", 0.0)),
        simulation=SimulationSettings(**simulation),
        emulator=EmulatorSettings(weights=weights, corrections=corrections),
        amplitude=amplitude,
    )


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("corrections", [0, 2])
def test_every_frame_is_skinning_plus_displacement(held, weights, sampled, corrections):
    if sampled:
        write_group(held.mesh, "All", np.ones(len(held.mesh.data.vertices)))
        held.modifier.vertex_group = "All"  # moves it as before, but is no plain Armature modifier
    settings = motion(weights, corrections=corrections, gravity=2.0, damping_ratio=0.1)
    expected = held.displacements(1, 8, settings)
    report = held.bake(ObjectSettings(motion=settings)).objects[0]
    assert report.warnings == ()
    assert max(np.abs(step).max() for step in expected) > 0.01 * held.size
    for frame, wanted in enumerate(expected, 1):
        shown = held.positions(frame) - held.skinned(frame)
        assert np.abs(shown - wanted).max() < (1e-4 if sampled else 1e-5) * held.size


def test_corrections_bring_the_bake_to_the_simulation(held, weights):
    def offsets(settings):
        held.bake(ObjectSettings(motion=settings))
        return held.offsets()

    true = offsets(motion(weights, solver="implicit-euler", quality="converged"))
    errors = [np.abs(offsets(motion(weights, corrections=n)) - true).max() for n in (0, 1, 20)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.03 * np.abs(true).max() < errors[0]


@pytest.mark.parametrize("solver", ["springs", "emulator", "implicit-euler"])
def test_amplitude_scales_what_is_baked(held, weights, solver):
    def displacements(amplitude):
        held.bake(ObjectSettings(motion=motion(weights, solver=solver, amplitude=amplitude)))
        return np.array([held.positions(frame) - held.skinned(frame) for frame in range(1, 9)])

    plain = displacements(1.0)
    assert np.abs(plain).max() > 0.01
    assert np.abs(displacements(0.5) - 0.5 * plain).max() < 1e-5
    assert not displacements(0.0).any()
    assert not held.offsets().any()


@pytest.mark.parametrize("solver", ["springs", "emulator", "implicit-euler"])
def test_every_solver_feels_gravity(held, weights, solver):
    tip = int(np.argmax([vertex.co.z for vertex in held.mesh.data.vertices]))
    heights = []
    for gravity in (0.0, 9.81):
        held.bake(ObjectSettings(motion=motion(weights, solver=solver, gravity=gravity)))
        heights.append(held.positions(2)[tip, 2])
    assert heights[1] < heights[0] - 1e-3


def test_flesh_that_was_not_learned_is_told_before_the_bake_and_after_it(held, weights):
    parameters = EmulatorWeights.load(weights).parameters
    EmulatorWeights(parameters, TrainedOn(stiffness_range=(60.0, 150.0))).save(weights)
    settings = ObjectSettings(motion=motion(weights))
    before = caution_before_bake(held.mesh, settings, bpy.context.scene)
    assert "vertices are softer than the emulator has learned" in before
    assert "Simulation" in before
    bake = Bake(bpy.context.scene, {held.mesh_name: settings})
    assert bake.cautions == (f"Creature: {before}",)
    for _ in bake.run():
        pass
    assert bake.finish().objects[0].warnings[0] == f"Creature: {before}"
    for solver in ("springs", "implicit-euler"):
        other = ObjectSettings(motion=motion(weights, solver=solver))
        assert caution_before_bake(held.mesh, other, bpy.context.scene) == ""
        assert held.bake(other).objects[0].warnings == ()


def test_without_weights_nothing_is_baked(held, tmp_path, monkeypatch):
    monkeypatch.setattr(emulator_weights, "SHIPPED", tmp_path / "emulator.npz")
    with pytest.raises(ValueError, match=r"'Creature': weights: this version .* brings none"):
        held.bake(ObjectSettings(motion=motion(None)))
    assert held.mesh.data.shape_keys is None


def test_the_bake_command_runs_it(held, weights, tmp_path, capfd):
    source, target = tmp_path / "in.blend", tmp_path / "out.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))
    command = ["bake", str(source), "-o", str(target), "--cells", "8", "--quiet"]

    def largest(*options):
        assert main([*command, *options]) == 0
        said = capfd.readouterr()
        line = next(line for line in said.out.splitlines() if line.startswith("Creature:"))
        return float(line.split("largest displacement ")[1].split()[0]), said.err

    emulator = ["--solver", "emulator", "--weights", str(weights)]
    usual, said = largest(*emulator)
    assert usual > 0.01 and "warning" not in said
    assert largest(*emulator, "--amplitude", "0.5")[0] == pytest.approx(0.5 * usual, rel=1e-3)
    assert largest(*emulator, "--corrections", "2")[0] != usual
    assert largest(*emulator, "--gravity", "5")[0] != usual
    assert largest(*emulator, "--damping-ratio", "1")[0] != usual
    assert largest("--solver", "springs", "--gravity", "5")[0] != largest("--solver", "springs")[0]
    said = largest(*emulator, "--youngs-modulus", "1")[1]
    assert said.count("softer than the emulator has learned") == 1
    assert "implicit-euler" in said
    assert main([*command, "--solver", "springs", "--corrections", "2"]) == 2
    assert "--corrections: found together with --solver springs, expected only with emulator" in capfd.readouterr().err
    assert main([*command, *emulator, "--amplitude", "-1"]) == 2
    assert "amplitude: found -1" in capfd.readouterr().err


def test_weights_that_come_along_make_it_the_default_of_the_command(held, weights, tmp_path, monkeypatch, capfd):
    source, target = tmp_path / "in.blend", tmp_path / "out.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))
    offsets = []
    for shipped, options in ((weights, []), (tmp_path / "none.npz", []), (weights, ["--solver", "springs"])):
        monkeypatch.setattr(emulator_weights, "SHIPPED", shipped)
        assert main(["bake", str(source), "-o", str(target), "--cells", "8", "--quiet", *options]) == 0
        offsets.append(held.offsets())
    assert not np.array_equal(offsets[0], offsets[1])
    assert np.array_equal(offsets[1], offsets[2])
