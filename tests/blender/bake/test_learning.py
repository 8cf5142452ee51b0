# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs learned from a simulation: what is kept on the mesh, and what a bake makes of it."""

from __future__ import annotations

import dataclasses

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    FrameRange,
    Learning,
    NotBakeableError,
    ObjectSettings,
    has_learned,
    read_learned,
    remove_learned,
    write_group,
)
from followthrough.blender.learned_springs import DAMPING_ATTRIBUTE, STIFFNESS_ATTRIBUTE
from followthrough.cli import main
from followthrough.settings import Settings, SimulationSettings, SpringSettings, VolumeSettings

FRAMES = FrameRange(1, 40)
MOTION = Settings(solver="springs", volume=VolumeSettings(cells=8))
SETTINGS = ObjectSettings(motion=MOTION)


@pytest.fixture
def swinging(character):
    """The column with its lower third pinned and 40 frames of swinging."""
    heights = np.array([vertex.co.z for vertex in character.mesh.data.vertices]) / character.size
    write_group(character.mesh, "Followthrough Pins", np.where(heights < 0.3, 1.0, 0.0))
    bone = character.armature.pose.bones["Upper"]
    for frame in range(9, 41):
        bone.rotation_euler.x = 0.5 * np.sin(0.9 * frame) + 0.3 * np.sin(0.37 * frame)
        bone.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_end = 40
    return character


def learn(character, settings: ObjectSettings = SETTINGS, frames: FrameRange = FRAMES):
    learning = Learning(bpy.context.scene, {character.mesh_name: settings}, frames)
    for _ in learning.run():
        pass
    return learning.finish()


def with_springs(**springs: object) -> Settings:
    return dataclasses.replace(MOTION, springs=SpringSettings(**springs))


def distance(first, second) -> float:
    return float(np.sqrt(np.mean((np.array(first) - np.array(second)) ** 2)))


def test_learned_springs_come_closer_to_the_simulation_than_painted_ones(swinging):
    flesh = dataclasses.replace(MOTION, solver="implicit-euler")
    true = swinging.displacements(1, 40, flesh)
    painted = swinging.displacements(1, 40, MOTION)
    report = learn(swinging).objects[0]
    learned = swinging.displacements(1, 40, MOTION)
    assert 0 < report.learned < report.vertices
    assert report.rmse < 0.7 * report.reference_rmse
    nothing = distance(true, np.zeros_like(true))
    assert distance(true, learned) < 0.75 * min(nothing, distance(true, painted))
    # Switched off they change nothing.
    assert np.array_equal(swinging.displacements(1, 40, with_springs(use_learned=False)), painted)


def test_what_is_kept_is_what_was_learned_and_goes_with_the_file(swinging, tmp_path):
    learn(swinging)
    learned = read_learned(swinging.mesh)
    heights = np.array([vertex.co.z for vertex in swinging.mesh.data.vertices]) / swinging.size
    assert not learned.known[heights < 0.3].any()
    assert learned.known[heights > 0.6].all()
    assert learned.damping_ratio == SpringSettings().damping_ratio
    path = str(tmp_path / "kept.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    again = read_learned(swinging.mesh)
    assert np.array_equal(again.stiffness, learned.stiffness)
    assert remove_learned(swinging.mesh)
    assert not has_learned(swinging.mesh)
    assert read_learned(swinging.mesh) is None
    assert not remove_learned(swinging.mesh)


def test_sliders_and_paint_scale_what_was_learned(swinging):
    learn(swinging)
    low, high = SpringSettings().stiffness_range

    def size(**springs: object) -> float:
        return distance(swinging.displacements(1, 40, with_springs(**springs)), np.zeros(1))

    usual = size()
    assert size(stiffness_range=(16 * low, 16 * high)) < 0.7 * usual < usual < size(stiffness_range=(low / 4, high / 4))
    assert size(damping_ratio=2.0) != usual
    assert size(stiffness_range=(16 * low, 16 * high), scale_learned=False) == pytest.approx(usual)
    count = len(swinging.mesh.data.vertices)
    write_group(swinging.mesh, "Followthrough Stiffness", np.ones(count))
    assert size() < usual


def test_an_unpainted_value_keeps_its_painted_spring(swinging):
    learn(swinging)
    mesh = swinging.mesh.data
    values = np.zeros(len(mesh.vertices), dtype=np.float32)
    painted = swinging.displacements(1, 40, with_springs(use_learned=False))
    mesh.attributes[STIFFNESS_ATTRIBUTE].data.foreach_set("value", values)
    assert np.array_equal(swinging.displacements(1, 40, MOTION), painted)
    values[:] = np.nan
    mesh.attributes[DAMPING_ATTRIBUTE].data.foreach_set("value", values)
    assert np.array_equal(swinging.displacements(1, 40, MOTION), painted)


def test_learning_leaves_everything_else_as_it_was(swinging):
    swinging.bake(SETTINGS, FRAMES)
    keys = [block.name for block in swinging.mesh.data.shape_keys.key_blocks]
    offsets, frame = swinging.offsets(), bpy.context.scene.frame_current
    learn(swinging)
    assert [block.name for block in swinging.mesh.data.shape_keys.key_blocks] == keys
    assert not any(block.mute for block in swinging.mesh.data.shape_keys.key_blocks)
    assert np.array_equal(swinging.offsets(), offsets)
    assert bpy.context.scene.frame_current == frame


@pytest.mark.parametrize("steps", [1, 20, 40])
def test_cancelled_at_any_time_nothing_is_learned(swinging, steps):
    bpy.context.scene.frame_set(5)
    frame = bpy.context.scene.frame_current
    learning = Learning(bpy.context.scene, {swinging.mesh_name: SETTINGS}, FRAMES)
    for progress in learning.run():
        if progress.done == steps:
            break
    learning.cancel()
    assert not has_learned(swinging.mesh)
    assert bpy.context.scene.frame_current == frame
    with pytest.raises(RuntimeError):
        learning.finish()


def test_progress_counts_frames_and_the_fit(swinging):
    learning = Learning(bpy.context.scene, {swinging.mesh_name: SETTINGS}, FRAMES)
    done = [progress.done for progress in learning.run()]
    assert done == list(range(1, learning.total + 1))
    assert learning.total == 40 + 1
    learning.cancel()


@pytest.mark.parametrize(
    "motion",
    [
        dataclasses.replace(MOTION, amplitude=3.0),
        dataclasses.replace(MOTION, springs=SpringSettings(gravity=5.0), simulation=SimulationSettings(gravity=5.0)),
        dataclasses.replace(MOTION, solver="emulator"),
    ],
    ids=["amplitude", "gravity", "emulator"],
)
def test_what_acts_on_any_solver_is_not_learned(swinging, motion):
    learn(swinging)
    plain = read_learned(swinging.mesh)
    learn(swinging, ObjectSettings(motion=motion))
    learned = read_learned(swinging.mesh)
    assert np.array_equal(learned.stiffness, plain.stiffness)
    assert np.array_equal(learned.damping, plain.damping)


def test_amplitude_and_gravity_act_on_learned_springs(swinging):
    learn(swinging)
    plain = np.array(swinging.displacements(1, 40, MOTION))
    twice = np.array(swinging.displacements(1, 40, dataclasses.replace(MOTION, amplitude=2.0)))
    assert np.abs(twice - 2.0 * plain).max() < 1e-9
    sagging = np.array(swinging.displacements(1, 40, with_springs(gravity=2.0)))
    assert sagging[-1, :, 2].mean() < plain[-1, :, 2].mean() - 1e-3


def test_a_character_that_plays_a_point_cache_learns_alike(swinging, tmp_path):
    learn(swinging)
    plain = read_learned(swinging.mesh)
    remove_learned(swinging.mesh)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    cached = ObjectSettings(motion=MOTION, output="pc2")
    swinging.bake(cached, FRAMES)
    before = swinging.positions(20)
    learn(swinging, cached)
    assert np.array_equal(read_learned(swinging.mesh).stiffness, plain.stiffness)
    assert np.array_equal(swinging.positions(20), before)


def test_a_loop_is_learned_from_from_its_start(swinging):
    learning = Learning(bpy.context.scene, {swinging.mesh_name: SETTINGS}, FrameRange(1, 40, cycles=1))
    for _ in learning.run():
        pass
    recording = learning._recordings[swinging.mesh_name]
    report = learning.finish().objects[0]
    assert len(recording.displacements) == len(learning._schedule) - 1
    start = recording.reference[0]
    second = recording.reference[len(learning._schedule) - 40]
    assert np.allclose(start, second)  # the first frame of the last round
    assert report.rmse < 0.8 * report.reference_rmse


def test_a_mesh_that_something_else_moves_learns_too(swinging):
    count = len(swinging.mesh.data.vertices)
    write_group(swinging.mesh, "All", np.ones(count))
    write_group(swinging.mesh, "Followthrough Pins", np.full(count, 0.5))  # without a rig no core holds the inside
    swinging.modifier.vertex_group = "All"
    report = learn(swinging).objects[0]
    assert report.learned > 0.8 * count
    assert report.rmse < 0.8 * report.reference_rmse


def test_what_cannot_be_learned_from_is_said(swinging):
    with pytest.raises(ValueError, match="found 5, expected 10 or more"):
        learn(swinging, frames=FrameRange(1, 5))
    with pytest.raises(NotBakeableError, match="not in scene"):
        Learning(bpy.context.scene, {"Nobody": SETTINGS}, FRAMES)
    swinging.armature.animation_data_clear()
    with pytest.raises(ValueError, match="no vertex whose reference speeds up"):
        learn(swinging)
    assert not has_learned(swinging.mesh)


def test_the_bake_command_uses_them(swinging, tmp_path, capsys):
    learn(swinging)
    path = tmp_path / "in.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))

    def baked(*options: str):
        out = tmp_path / "out.blend"
        assert main(["bake", str(path), "-o", str(out), "--cells", "8", "--quiet", *options]) == 0
        bpy.ops.wm.open_mainfile(filepath=str(out))
        return swinging.offsets()

    learned = baked()
    painted = baked("--no-learned")
    assert np.abs(learned - painted).max() > 1e-3
    # Nothing is scaled unless it is asked for.
    assert np.array_equal(learned, baked("--preroll", "0"))
    assert np.abs(baked("--stiffness", "4000:64000")).max() < np.abs(learned).max()
    assert (
        main(["bake", str(path), "-o", str(tmp_path / "no.blend"), "--solver", "implicit-euler", "--no-learned"]) == 2
    )
    assert "use-learned" in capsys.readouterr().err
