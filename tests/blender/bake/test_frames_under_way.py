# SPDX-License-Identifier: GPL-3.0-or-later
"""Many frames of a bake are under way at once: nobody can tell from what comes out."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from followthrough.blender import Bake, FrameRange, ObjectSettings, bake_recovery, clear
from followthrough.blender import bake as bake_module
from followthrough.settings import Settings, SpringSettings, VolumeSettings

LAST = 40
SOFT = ObjectSettings(
    motion=Settings(
        solver="springs", volume=VolumeSettings(cells=8), springs=SpringSettings(stiffness_range=(60.0, 60.0))
    )
)
FRAMES = FrameRange(end=LAST)


def bake(character, frames=FRAMES, settings=SOFT):
    """The offsets of a bake at one go, and its report; nothing of it stays."""
    report = character.bake(settings, frames)
    offsets = character.offsets()
    clear(character.mesh)
    return offsets, report


@pytest.mark.parametrize("frames", [FRAMES, FrameRange(start=3, end=LAST, preroll=5), FrameRange(end=12, cycles=2)])
@pytest.mark.parametrize("sampled", [False, True], ids=["rigged", "sampled"])
def test_the_number_makes_no_difference(character, monkeypatch, frames, sampled):
    if sampled:
        character.mesh.modifiers.new("Bend", "SIMPLE_DEFORM").angle = 0.3
        frames = FrameRange(frames.start, min(frames.end, 8), frames.preroll, frames.cycles)
    found = []
    for number in (1, 2, 7, bake_module.UNDER_WAY):
        monkeypatch.setattr(bake_module, "UNDER_WAY", number)
        found.append(bake(character, frames))
    for offsets, report in found[1:]:
        assert offsets.tobytes() == found[0][0].tobytes()
        assert report.objects == found[0][1].objects
    assert np.abs(found[0][0]).max() > 0.01


def test_the_first_and_the_last_frame_are_those_of_a_simulation_step_by_step(character):
    steps = character.displacements(1, LAST, SOFT.motion)
    character.bake(SOFT, FRAMES)
    for frame in (1, 2, LAST - 1, LAST):
        shown = character.positions(frame) - character.skinned(frame)
        np.testing.assert_allclose(shown, steps[frame - 1], rtol=0, atol=1e-6 * character.size)
    assert np.abs(steps[1]).max() > 1e-3
    assert not np.abs(steps[0]).any()


def test_progress_never_goes_back(character):
    made = Bake(bpy.context.scene, {character.mesh_name: SOFT}, FRAMES)
    done = [progress.done for progress in made.run(patience=1e-6)]
    made.finish()
    assert done == sorted(done)
    assert set(done) == set(range(1, LAST + 1))


@pytest.mark.parametrize("steps", [2, 20, LAST - 1])
def test_stopped_with_many_under_way_it_leaves_nothing_and_bakes_again(character, steps):
    whole, _ = bake(character)
    made = Bake(bpy.context.scene, {character.mesh_name: SOFT}, FRAMES)
    run = made.run()
    for _ in range(steps):
        next(run)
    assert len(made._under_way) == steps - 1
    run.close()
    assert character.mesh.data.shape_keys is None
    again, _ = bake(character)
    assert again.tobytes() == whole.tobytes()


@pytest.mark.parametrize("frame", [2, 20, LAST])
def test_a_result_that_is_not_finite_is_told_with_its_frame(make_character, frame):
    """The object that is fine has frames under way, too."""
    fine, broken = make_character("A"), make_character("B")
    broken.armature.location.x = 5.0
    whole, _ = bake(fine)
    for bone in broken.armature.pose.bones:  # the sum of the two is more than a float holds
        bone.driver_add("location", 1).driver.expression = f"3e38 if frame >= {frame} else 0"
    made = Bake(bpy.context.scene, {fine.mesh_name: SOFT, broken.mesh_name: SOFT}, FRAMES)
    with pytest.raises(ValueError, match=rf"'B', frame {frame}:"):
        list(made.run())
    assert fine.mesh.data.shape_keys is None
    again, _ = bake(fine)
    assert again.tobytes() == whole.tobytes()


@pytest.mark.parametrize("steps", [9, 25, LAST - 1])
def test_the_cache_knows_the_solver_after_its_last_frame(character, monkeypatch, tmp_path, steps):
    whole, report = bake(character)
    ticks = count()  # of a clock by which a save is due every few frames
    with monkeypatch.context() as patch:
        patch.setattr(
            bake_recovery, "time", SimpleNamespace(monotonic=lambda: next(ticks) * bake_recovery.SAVE_INTERVAL / 6)
        )
        made = Bake(bpy.context.scene, {character.mesh_name: SOFT}, FRAMES, tmp_path / "cache")
        run = made.run()
        for _ in range(steps):
            next(run)
        run.close()
    saved = made.recovery.saved_frame
    assert 1 < saved <= steps
    again = Bake(bpy.context.scene, {character.mesh_name: SOFT}, FRAMES, tmp_path / "cache")
    list(again.run())
    resumed = again.finish()
    assert again.recovery.resumed_from == saved
    assert character.offsets().tobytes() == whole.tobytes()
    assert resumed.objects == report.objects
