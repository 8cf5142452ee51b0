# SPDX-License-Identifier: GPL-3.0-or-later
"""After a bake Blender shows its own skinning plus the simulated displacement, however the character is set up."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    PINS_GROUP,
    Bake,
    FrameRange,
    ObjectSettings,
    PaintGroups,
    PinGroup,
    baked_range,
    clear,
    write_group,
)
from followthrough.blender.shape_keys import our_names
from followthrough.settings import Settings, SpringSettings, VolumeSettings


def springs(stiffness: float, damping_ratio: float) -> ObjectSettings:
    """The same spring everywhere, in a coarse volume."""
    return ObjectSettings(
        motion=Settings(
            solver="springs",
            volume=VolumeSettings(cells=8),
            springs=SpringSettings(stiffness_range=(stiffness, stiffness), damping_ratio=damping_ratio),
        )
    )


COARSE = ObjectSettings(motion=Settings(solver="springs", volume=VolumeSettings(cells=8)))
SOFT = springs(60.0, 0.1)


def plain(character):
    pass


def preserve_volume(character):
    character.modifier.use_deform_preserve_volume = True


def preserve_volume_uneven_scale(character):
    character.modifier.use_deform_preserve_volume = True
    character.armature.scale = (1.0, 1.5, 0.7)
    character.armature.pose.bones["Upper"].scale = (1.3, 0.8, 1.1)
    character.armature.pose.bones["Lower"].scale = (0.9, 1.2, 1.0)


def moving_armature_object(character):
    for frame, x in ((1, 0.0), (4, 1.5), (8, 0.5)):
        character.armature.location.x = x
        character.armature.rotation_euler.z = x
        character.armature.keyframe_insert("location", frame=frame)
        character.armature.keyframe_insert("rotation_euler", frame=frame)


def mesh_apart_from_armature(character):
    character.mesh.parent = None
    character.mesh.location = (0.3, -0.2, 0.1)
    character.mesh.rotation_euler = (0.2, 0.4, -0.3)
    character.mesh.scale = (0.8, 1.3, 1.1)
    for frame, angle in ((1, 0.4), (8, 1.0)):
        character.mesh.rotation_euler.y = angle
        character.mesh.keyframe_insert("rotation_euler", frame=frame)


def idle_bone(character):
    character.armature.data.bones["Lower"].use_deform = False


def locked_group(character):
    for group in character.mesh.vertex_groups:
        group.lock_weight = True


def mirrored(character):
    character.armature.scale.x = -1.0


def subdivided(character):
    character.mesh.modifiers.new("Subdivision", "SUBSURF").levels = 1
    character.mesh.modifiers["Subdivision"].show_viewport = False  # so that the test counts its own vertices


def finished_keys(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.shape_key_add(name="Fat").value = 0.0  # and not animated: takes no part


@pytest.mark.parametrize(
    "prepare",
    [
        plain,
        preserve_volume,
        preserve_volume_uneven_scale,
        moving_armature_object,
        mesh_apart_from_armature,
        idle_bone,
        locked_group,
        mirrored,
        subdivided,
        finished_keys,
    ],
)
def test_every_frame_is_skinning_plus_displacement(character, prepare):
    prepare(character)
    expected = character.displacements(1, 8)
    report = character.bake()
    assert not report.objects[0].evaluations_per_frame
    assert max(np.abs(step).max() for step in expected) > 0.01 * character.size
    for frame, displacement in enumerate(expected, start=1):
        error = character.positions(frame) - character.skinned(frame) - displacement
        assert np.abs(error).max() < 1e-5 * character.size
    largest = max(np.linalg.norm(step, axis=1).max() for step in expected)
    assert report.objects[0].largest_displacement == pytest.approx(largest)


def test_between_frames_it_is_linear(character):
    character.bake()
    key = character.mesh.data.shape_keys
    offsets = character.offsets()
    for frame, share in ((3, 0.25), (5, 0.5)):
        bpy.context.scene.frame_set(frame, subframe=share)
        values = np.array([key.key_blocks[f"Followthrough {index:04d}"].value for index in range(1, 9)])
        expected = np.zeros(8)
        expected[frame - 1], expected[frame] = 1 - share, share
        assert values == pytest.approx(expected, abs=1e-6)
        character.modifier.show_viewport = False
        shown = character.positions(frame + share, world=False) - character.skinned(frame + share)
        assert shown == pytest.approx(np.tensordot(expected, offsets, 1), abs=1e-5)
        character.modifier.show_viewport = True


def test_outside_the_range_nothing_moves(character):
    character.bake(frames=FrameRange(start=3, end=6))
    assert baked_range(character.mesh) == (3, 6)
    for frame in (-5, 1, 2, 7, 8, 100):
        assert np.array_equal(character.positions(frame), character.skinned(frame))


def test_pinned_vertices_follow_the_armature_exactly(character):
    pins = np.zeros(len(character.mesh.data.vertices))
    pins[::5] = 1.0
    write_group(character.mesh, PINS_GROUP, pins)
    character.bake(SOFT)
    moved = np.zeros(len(pins))
    for frame in range(1, 9):
        moved = np.maximum(moved, np.abs(character.positions(frame) - character.skinned(frame)).max(axis=1))
    assert not moved[::5].any()
    assert moved.max() > 0.0


def test_pin_groups_have_strengths(character):
    for name in ("A", "B"):
        write_group(character.mesh, name, np.ones(len(character.mesh.data.vertices)))

    def largest(*pins: PinGroup) -> float:
        settings = ObjectSettings(motion=COARSE.motion, groups=PaintGroups(pins=pins))
        return character.bake(settings).objects[0].largest_displacement

    free, soft, hard = largest(), largest(PinGroup("A", 0.5)), largest(PinGroup("A", 0.5), PinGroup("B"))
    assert free > soft > hard == 0.0


def test_a_seam_does_not_open(make_character):
    character = make_character(seam=True)
    character.bake(SOFT)
    rest = np.array([vertex.co for vertex in character.mesh.data.vertices])
    twins = np.argmin(np.linalg.norm(rest[-8:, None] - rest[None, :-8], axis=2), axis=1)
    for frame in range(1, 9):
        positions = character.positions(frame)
        assert np.array_equal(positions[-8:], positions[twins])


def test_several_meshes_are_baked_in_one_pass_as_each_alone(make_character):
    characters = [make_character("One"), make_character("Two")]
    characters[1].armature.location.x = 5.0
    bpy.context.view_layer.update()
    alone = []
    for character in characters:
        character.bake()
        alone.append(character.offsets())
        clear(character.mesh)
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE for character in characters})
    assert [progress.frame for progress in bake.run()] == list(range(1, 9))
    assert [entry.name for entry in bake.finish().objects] == ["One", "Two"]
    for character, offsets in zip(characters, alone, strict=True):
        assert np.array_equal(character.offsets(), offsets)


def test_baking_again_gives_the_same_bytes(character):
    bpy.context.scene.frame_set(4, subframe=0.5)
    character.bake()
    first = character.offsets()
    names = [block.name for block in character.mesh.data.shape_keys.key_blocks]
    actions = sorted(action.name for action in bpy.data.actions)
    character.bake()
    assert character.offsets().tobytes() == first.tobytes()
    assert [block.name for block in character.mesh.data.shape_keys.key_blocks] == names
    assert sorted(action.name for action in bpy.data.actions) == actions
    character.bake(frames=FrameRange(start=2, end=4))
    assert [block.name for block in character.mesh.data.shape_keys.key_blocks] == ["Basis", *names[2:5]]
    assert sorted(action.name for action in bpy.data.actions) == actions


def snapshot(character):
    """Everything a cancelled bake must leave as it was."""
    mesh = character.mesh
    key = mesh.data.shape_keys
    blocks = (
        [] if key is None else [(b.name, b.mute, np.array([p.co for p in b.data]).tobytes()) for b in key.key_blocks]
    )
    return (
        bpy.context.scene.frame_current,
        bpy.context.scene.frame_subframe,
        mesh.mode,
        blocks,
        sorted(action.name for action in bpy.data.actions),
        [(modifier.name, modifier.show_viewport) for modifier in mesh.modifiers],
        len(bpy.data.objects),
        len(bpy.data.meshes),
        [group.name for group in mesh.vertex_groups],
        np.array([vertex.co for vertex in mesh.data.vertices]).tobytes(),
    )


@pytest.mark.parametrize("sampled", [False, True])
@pytest.mark.parametrize("baked", [False, True])
@pytest.mark.parametrize("steps", [0, 1, 5, 8])
def test_cancelling_leaves_nothing_changed(character, sampled, baked, steps):
    if sampled:
        character.mesh.modifiers.new("Wave", "SIMPLE_DEFORM").angle = 0.3
        character.mesh.modifiers.new("Subdivision", "SUBSURF").levels = 1
    if baked:
        character.bake()
        character.mesh.data.shape_keys.key_blocks[3].mute = True
    bpy.context.scene.frame_set(5, subframe=0.25)
    before = snapshot(character)
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE})
    run = bake.run()
    for _ in range(steps):
        next(run)
    bake.cancel()
    bake.cancel()
    assert snapshot(character) == before
    with pytest.raises(RuntimeError, match="finish"):
        bake.finish()


def test_leaving_the_loop_cancels(character):
    before = snapshot(character)
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE})
    for progress in bake.run():
        if progress.done == 3:
            break
    assert snapshot(character) == before
    with pytest.raises(RuntimeError, match="finish"):
        bake.finish()


def test_a_bake_from_edit_mode_returns_there(character):
    bpy.context.view_layer.objects.active = character.mesh
    bpy.ops.object.mode_set(mode="EDIT")
    character.bake()
    assert character.mesh.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    in_edit_mode = character.offsets()
    clear(character.mesh)
    character.bake()
    assert np.array_equal(character.offsets(), in_edit_mode)


def test_the_frame_is_put_back(character):
    bpy.context.scene.frame_set(6, subframe=0.5)
    character.bake()
    assert (bpy.context.scene.frame_current, bpy.context.scene.frame_subframe) == (6, 0.5)


def test_the_result_is_not_finite_names_the_frame(character):
    for bone in character.armature.pose.bones:  # the sum of the two is more than a float holds
        bone.driver_add("location", 1).driver.expression = "3e38 if frame > 4 else 0"
    before = snapshot(character)
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE})
    with pytest.raises(ValueError, match=r"'Creature', frame 5"):
        list(bake.run())
    assert snapshot(character) == before
    assert character.mesh.data.shape_keys is None


def test_an_object_that_disappears_stops_the_bake(character):
    bake = Bake(bpy.context.scene, {character.mesh_name: COARSE})
    run = bake.run()
    next(run)
    bpy.data.objects.remove(character.mesh)
    with pytest.raises(ValueError, match="no longer there"):
        list(run)


def test_preroll_is_simulated_and_not_keyed(character):
    whole = character.bake(frames=FrameRange(start=1, end=8)) and character.offsets()
    report = character.bake(frames=FrameRange(start=4, end=8, preroll=3))
    assert report.objects[0].frames == 5
    assert np.array_equal(character.offsets(), whole[3:])
    assert np.abs(character.offsets()[0]).max() > 0.0


def test_cycles_close_the_seam_of_a_loop(character):
    damped = springs(60.0, 0.6)
    character.bake(damped)
    offsets = character.offsets()
    opened = np.abs(offsets[0] - offsets[-1]).max()
    character.bake(damped, FrameRange(cycles=12))
    offsets = character.offsets()
    assert np.abs(offsets).max() > 0.01
    assert np.abs(offsets[0] - offsets[-1]).max() < 1e-3 * opened


def test_a_copy_100_times_as_large_gives_the_scaled_bake(make_character):
    small, large, stretched = make_character("Small"), make_character("Large", size=100.0), make_character("Stretched")
    stretched.armature.scale = (100.0, 100.0, 100.0)
    bpy.context.view_layer.update()
    for character in (small, large, stretched):
        character.bake(SOFT)
    scale = np.abs(small.offsets()).max()
    assert scale > 0.01
    assert np.abs(large.offsets() / 100.0 - small.offsets()).max() < 1e-4 * scale
    assert np.abs(stretched.offsets() - small.offsets()).max() < 1e-4 * scale
    for frame in (3, 6):
        assert np.abs(stretched.positions(frame) / 100.0 - small.positions(frame)).max() < 1e-5 * small.size


def slide(character, velocity: float, seconds_still: float, fps: float) -> None:
    """Moves the whole rig steadily along x after a rest, in seconds."""
    character.armature.animation_data_clear()
    curve = character.armature.driver_add("location", 0)
    curve.driver.expression = f"max(0, frame / {fps} - {seconds_still}) * {velocity}"


def test_steady_motion_from_rest_comes_to_the_steady_answer(make_character):
    character = make_character(animate=False)
    slide(character, velocity=1.0, seconds_still=0.25, fps=24.0)
    quick = springs(400.0, 1.0)
    character.bake(quick, FrameRange(start=0, end=48))
    offsets = np.abs(character.offsets()).max(axis=(1, 2))
    assert not offsets[:5].any()
    assert offsets.max() > 0.01
    # The springs damp the motion relative to their targets, so a steady motion is followed without lag.
    assert offsets[-1] < 1e-4 * offsets.max()


def test_frame_rates_agree_in_seconds(make_character):
    character = make_character(animate=False)
    scene = bpy.context.scene
    tip = np.argmax([vertex.co.z for vertex in character.mesh.data.vertices])
    curve = character.armature.driver_add("location", 0)

    def track(fps, base):
        scene.render.fps, scene.render.fps_base = fps, base
        rate = fps / base
        curve.driver.expression = f"0.5 * sin({2 * math.pi} * frame / {rate}) ** 4"
        frames = math.ceil(rate)
        character.bake(SOFT, FrameRange(start=0, end=frames))
        return np.arange(frames + 1) / rate, character.offsets()[:, tip, 0]

    seconds, fine = track(240, 1.0)
    for fps, base in ((24, 1.0), (30, 1.001), (30, 1.0), (60, 1.0)):
        times, offsets = track(fps, base)
        error = np.abs(offsets - np.interp(times, seconds, fine)).max() / np.abs(fine).max()
        assert error < 0.03 * (24.0 * base / fps)


def test_our_keys_are_told_from_others_by_name_and_curve(character):
    character.bake()
    key = character.mesh.data.shape_keys
    key.key_blocks["Followthrough 0003"].name = "Renamed"
    assert "Renamed" in our_names(key)
    assert "Basis" not in our_names(key)
