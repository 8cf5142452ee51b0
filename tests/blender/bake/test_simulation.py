# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake with simulated flesh: what is shown is what the solver says, at any scale; long frames can be left."""

from __future__ import annotations

import dataclasses
import itertools
import time

import bpy
import numpy as np
import pytest

from followthrough import flesh
from followthrough.blender import Bake, FrameRange, ObjectReport, ObjectSettings, PaintGroups, PinGroup, write_group
from followthrough.elastic import ImplicitEuler
from followthrough.secondary_motion import SecondaryMotion
from followthrough.settings import Settings, SimulationSettings, VolumeSettings

FLESH = SimulationSettings(quality="converged")


def simulated(simulation: SimulationSettings = FLESH, cells: int = 8, **groups: object) -> ObjectSettings:
    motion = Settings(
        volume=VolumeSettings(cells=cells, core_radius=0.0), solver="implicit-euler", simulation=simulation
    )
    return ObjectSettings(motion=motion, groups=PaintGroups(**groups))


@pytest.fixture
def held(character):
    """The column with its lower third pinned, a soft collar, and the rest free."""
    hold(character)
    return character


def hold(character) -> None:
    heights = np.array([vertex.co.z for vertex in character.mesh.data.vertices]) / character.size
    pins = np.where(heights < 0.3, 1.0, np.where(heights < 0.45, 0.4, 0.0))
    write_group(character.mesh, "Followthrough Pins", pins)


def shown(character, start: int = 1, end: int = 8):
    return [character.positions(frame) - character.skinned(frame) for frame in range(start, end + 1)]


@pytest.mark.parametrize("sampled", [False, True])
def test_every_frame_is_skinning_plus_displacement(held, sampled):
    if sampled:
        write_group(held.mesh, "All", np.ones(len(held.mesh.data.vertices)))
        held.modifier.vertex_group = "All"  # moves it as before, but is no plain Armature modifier
    settings = simulated(dataclasses.replace(FLESH, gravity=3.0, damping_ratio=0.1))
    expected = held.displacements(1, 8, settings.motion)
    report = held.bake(settings).objects[0]
    assert bool(report.evaluations_per_frame) == sampled
    assert report.unconverged == ()
    assert report.warnings == ()
    assert max(np.abs(step).max() for step in expected) > 0.01 * held.size
    for displacement, wanted in zip(shown(held), expected, strict=True):
        assert np.abs(displacement - wanted).max() < (1e-4 if sampled else 1e-5) * held.size
    heights = np.array([vertex.co.z for vertex in held.mesh.data.vertices])
    assert not any(displacement[heights < 0.3 * held.size].any() for displacement in shown(held))


def test_settings_and_paint_reach_the_flesh(held):
    def largest(simulation: SimulationSettings = FLESH, **groups: object) -> float:
        return held.bake(simulated(simulation, **groups)).objects[0].largest_displacement

    usual = largest()
    assert largest(dataclasses.replace(FLESH, youngs_modulus_range=(1e4, 5e5))) < usual
    assert largest(dataclasses.replace(FLESH, density_range=(25.0, 400.0))) < usual
    assert largest(dataclasses.replace(FLESH, gravity=20.0)) != usual
    assert largest(dataclasses.replace(FLESH, damping_ratio=1.0)) < usual
    for group in ("Ones", "Some"):
        write_group(held.mesh, group, np.full(len(held.mesh.data.vertices), 1.0 if group == "Ones" else 0.8))
    assert largest(stiffness="Ones") < usual < largest(mass="Ones")
    usual_pins = PinGroup("Followthrough Pins")
    assert largest(pins=(usual_pins, PinGroup("Some"))) < largest(pins=(usual_pins, PinGroup("Some", 0.2))) < usual
    assert largest(pins=(PinGroup("Ones"),)) == 0.0


def test_a_copy_100_times_as_large_gives_the_scaled_bake(make_character):
    small, large, stretched = make_character("Small"), make_character("Large", size=100.0), make_character("Stretched")
    rooted = make_character("Rooted")
    stretched.armature.scale = (100.0, 100.0, 100.0)
    for bone in rooted.armature.pose.bones:
        if bone.parent is None:
            bone.scale = (3.0, 3.0, 3.0)  # an animator fits the character into the scene
    bpy.context.view_layer.update()
    settings = simulated(dataclasses.replace(FLESH, gravity=2.0))
    for character in (small, large, stretched, rooted):
        hold(character)
        character.bake(settings)
    scale = np.abs(small.offsets()).max()
    assert scale > 0.01
    assert np.abs(large.offsets() / 100.0 - small.offsets()).max() < 1e-3 * scale
    assert np.abs(stretched.offsets() - small.offsets()).max() < 1e-3 * scale
    for a, b, c in zip(shown(small), shown(stretched), shown(rooted), strict=True):
        assert np.abs(b / 100.0 - a).max() < 1e-3 * scale
        assert np.abs(c / 3.0 - a).max() < 1e-3 * scale


def test_frame_rates_agree_as_backward_euler_allows(make_character):
    character = make_character(animate=False)
    hold(character)
    scene = bpy.context.scene
    tip = np.argmax([vertex.co.z for vertex in character.mesh.data.vertices])
    curve = character.armature.driver_add("location", 0)
    stiff = dataclasses.replace(FLESH, youngs_modulus_range=(2e4, 2e5))

    def track(fps):
        scene.render.fps = fps
        curve.driver.expression = f"0.3 * min(1, max(0, frame / {fps} - 0.2) * 3)"
        character.bake(simulated(stiff), FrameRange(start=0, end=fps))
        return np.arange(fps + 1) / fps, character.offsets()[:, tip, 0]

    seconds, fine = track(240)
    errors = []
    for fps in (24, 48, 96):
        times, offsets = track(fps)
        errors.append(np.abs(offsets - np.interp(times, seconds, fine)).max() / np.abs(fine).max())
    assert errors[0] < 0.5
    assert errors[1] < 0.75 * errors[0]  # first order: half the step, about half the error
    assert errors[2] < 0.75 * errors[1]


def test_flesh_that_nothing_holds_is_refused_by_name(character):
    write_group(character.mesh, "Nothing", np.zeros(len(character.mesh.data.vertices)))
    with pytest.raises(ValueError, match=r"'Creature': pins: found none .*paint pins"):
        Bake(bpy.context.scene, {character.mesh_name: simulated(pins=(PinGroup("Nothing"),))})
    assert character.mesh.data.shape_keys is None


def test_soft_pins_alone_hold(character):
    write_group(character.mesh, "Collar", np.full(len(character.mesh.data.vertices), 0.5))
    report = character.bake(simulated(pins=(PinGroup("Collar"),)))
    assert 0.0 < report.objects[0].largest_displacement < character.size
    assert report.objects[0].unconverged == ()


def test_parts_that_nothing_holds_follow_and_are_reported(held):
    mesh = held.mesh
    count = len(mesh.data.vertices)
    other = mesh.copy()
    other.data = mesh.data.copy()
    for vertex in other.data.vertices:
        vertex.co.x += 3.0
    bpy.context.scene.collection.objects.link(other)
    with bpy.context.temp_override(active_object=mesh, selected_editable_objects=[mesh, other]):
        bpy.ops.object.join()
    pins = mesh.vertex_groups["Followthrough Pins"]
    pins.remove(range(count, 2 * count))
    report = held.bake(simulated(cells=16)).objects[0]
    assert report.loose_vertices == count
    assert "no pin holds 72 vertices" in report.warnings[0]
    displacement = np.abs(shown(held)).max(axis=(0, 2))
    assert displacement[:count].max() > 0.01
    assert not displacement[count:].any()


def test_frames_that_do_not_converge_are_told(held, monkeypatch):
    def hasty(*arguments, **options):
        return ImplicitEuler(*arguments, **{**options, "most_iterations": 1})

    monkeypatch.setattr(flesh, "ImplicitEuler", hasty)  # stops after one iteration, whatever it is asked for
    floppy = SimulationSettings(youngs_modulus_range=(200.0, 200.0), quality="fine")
    report = held.bake(simulated(floppy)).objects[0]
    assert report.unconverged
    assert set(report.unconverged) <= set(range(1, 9))
    assert "not converged" in report.warnings[0]
    assert np.isfinite(held.offsets()).all()
    # Preview promises bounded work, not convergence.
    assert held.bake(simulated(dataclasses.replace(floppy, quality="preview"))).objects[0].unconverged == ()


def test_warnings_name_frames_in_runs():
    frames = (3, 7, 8, 9, 12, 20, 22, 24, 26)
    report = ObjectReport("Bear", 30, 8, 6, 1.0, 0.0, unconverged=frames)
    assert report.warnings[0].startswith("Bear: 9 frames have not converged (3, 7-9, 12, 20, 22, 24 ...)")
    assert ObjectReport("Bear", 30, 8, 6, 1.0, 0.2).warnings[0].startswith("Bear: the rig flattens")
    assert ObjectReport("Bear", 30, 8, 6, 1.0, 0.01).warnings == ()


@pytest.fixture
def slow(monkeypatch):
    """Every frame is done only when it has been waited for a third time."""
    wait = SecondaryMotion.wait
    waits = itertools.count(1)

    def wait_longer(self, seconds):
        return next(waits) % 3 == 0 and wait(self, 60.0)

    monkeypatch.setattr(SecondaryMotion, "wait", wait_longer)


def test_a_long_frame_lets_go_meanwhile(held, slow):
    held.bake(simulated())
    offsets = held.offsets()
    bake = Bake(bpy.context.scene, {held.mesh_name: simulated()})
    progress = [step.done for step in bake.run(patience=0.01)]
    bake.finish()
    # The first frame is the start itself; each of the others comes again and again until it is done.
    assert progress == [1, *(done for done in range(2, 9) for _ in range(3))]
    assert np.array_equal(held.offsets(), offsets)


def test_a_frame_under_way_is_abandoned_at_once(held):
    bpy.context.scene.frame_set(5)
    # About half a second a frame, as a large character takes.
    settings = simulated(dataclasses.replace(FLESH, youngs_modulus_range=(20.0, 20.0)), cells=48)
    bake = Bake(bpy.context.scene, {held.mesh_name: settings})
    run = bake.run(patience=0.001)
    steps = 0
    for progress in run:
        steps += 1
        if progress.done == 2 and steps > 3:
            break
    began = time.perf_counter()
    bake.cancel()
    assert time.perf_counter() - began < 0.2
    assert bpy.context.scene.frame_current == 5
    assert held.mesh.data.shape_keys is None
