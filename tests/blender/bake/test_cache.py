# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake that was stopped goes on from its cache, to the bit; a cache of anything else is recognised, and nothing is left in the end."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    PINS_GROUP,
    Bake,
    FrameRange,
    ObjectSettings,
    bake_recovery,
    cache_folder,
    clear,
    resumable_frame,
    write_group,
)
from followthrough.blender.bake_cache import BakeCache
from followthrough.blender.learned_springs import write_learned
from followthrough.character import LearnedSprings
from followthrough.emulator_weights import EmulatorWeights
from followthrough.settings import EmulatorSettings, Settings, SimulationSettings, SpringSettings, VolumeSettings

COARSE = VolumeSettings(cells=8)
SPRINGS = ObjectSettings(
    motion=Settings(volume=COARSE, solver="springs", springs=SpringSettings(stiffness_range=(60.0, 60.0)))
)
FLESH = ObjectSettings(
    motion=Settings(volume=COARSE, solver="implicit-euler", simulation=SimulationSettings(quality="preview"))
)


@pytest.fixture(autouse=True)
def saved_every_frame(monkeypatch):
    monkeypatch.setattr(bake_recovery, "SAVE_INTERVAL", 0.0)


def begun(character, cache, settings=SPRINGS, frames=None):
    return Bake(bpy.context.scene, {character.mesh_name: settings}, frames, cache)


def stopped(character, cache, steps, settings=SPRINGS, frames=None):
    """A bake that got so far."""
    bake = begun(character, cache, settings, frames)
    run = bake.run()
    for _ in range(steps):
        next(run)
    bake.cancel()
    return bake


def completed(bake):
    for _ in bake.run():
        pass
    return bake.finish()


def baked(character, settings=SPRINGS, frames=None):
    """The offsets of a bake at one go; nothing of it stays."""
    character.bake(settings, frames)
    offsets = character.offsets()
    clear(character.mesh)
    return offsets


def controlled(weights, solver="emulator", corrections=1):
    """All that can be set around a solver."""
    return ObjectSettings(
        motion=Settings(
            volume=VolumeSettings(cells=8, core_radius=0.0),
            solver=solver,
            springs=SpringSettings(gravity=2.0),
            simulation=SimulationSettings(gravity=2.0, damping_ratio=0.1),
            emulator=EmulatorSettings(weights=weights, corrections=corrections),
            amplitude=1.5,
        )
    )


def with_lattice(character):
    lattice = bpy.data.objects.new("Lattice", bpy.data.lattices.new("Lattice"))
    bpy.context.scene.collection.objects.link(lattice)
    lattice.location.z, lattice.scale = 1.0, (2.0, 2.0, 3.0)
    lattice.data.points[0].co_deform.x += 0.2
    character.mesh.modifiers.new("Lattice", "LATTICE").object = lattice
    bpy.context.view_layer.update()


@pytest.mark.parametrize("steps", [3, 5, 8])
@pytest.mark.parametrize("settings", [SPRINGS, FLESH], ids=["springs", "flesh"])
@pytest.mark.parametrize(
    "frames", [None, FrameRange(start=3, preroll=2), FrameRange(cycles=2)], ids=["plain", "preroll", "loop"]
)
def test_a_stopped_bake_goes_on_to_the_same_bits(character, tmp_path, settings, frames, steps):
    pins = np.where(np.arange(len(character.mesh.data.vertices)) < 8, 1.0, 0.0)
    write_group(character.mesh, PINS_GROUP, pins)
    whole = baked(character, settings, frames)
    report = character.bake(settings, frames)
    clear(character.mesh)
    folder = tmp_path / "cache"
    first = stopped(character, folder, steps, settings, frames)
    assert character.mesh.data.shape_keys is None
    again = begun(character, folder, settings, frames)
    resumed = completed(again)
    assert again.recovery.resumed_from == first.recovery.saved_frame
    assert not again.recovery.has_begun_anew
    assert character.offsets().tobytes() == whole.tobytes()
    assert resumed.objects == report.objects
    assert not folder.exists()


@pytest.mark.parametrize("sampled", [False, True], ids=["rigged", "sampled"])
@pytest.mark.parametrize(
    ("solver", "corrections"), [("springs", 0), ("emulator", 0), ("emulator", 2), ("implicit-euler", 0)]
)
def test_with_all_controls_it_goes_on_to_the_same_bits(held, weights, tmp_path, solver, sampled, corrections):
    if sampled:
        write_group(held.mesh, "All", np.ones(len(held.mesh.data.vertices)))
        held.modifier.vertex_group = "All"  # moves it as before, but is no plain Armature modifier
    settings = controlled(weights, solver, corrections)
    whole = baked(held, settings)
    first = stopped(held, tmp_path / "cache", 5, settings)
    again = begun(held, tmp_path / "cache", settings)
    completed(again)
    assert again.recovery.resumed_from == first.recovery.saved_frame == 5
    assert np.abs(whole).max() > 0.01
    if sampled:  # offsets are searched from where the last search ended
        assert np.abs(held.offsets() - whole).max() < 1e-4 * held.size
    else:
        assert held.offsets().tobytes() == whole.tobytes()


def test_other_weights_in_the_same_file_begin_anew(held, weights, tmp_path):
    settings = controlled(weights)
    stopped(held, tmp_path / "cache", 5, settings)
    old = EmulatorWeights.load(weights)
    EmulatorWeights({name: 0.9 * array for name, array in old.parameters.items()}, old.trained_on).save(weights)
    whole = baked(held, settings)
    again = begun(held, tmp_path / "cache", settings)
    completed(again)
    assert again.recovery.resumed_from is None
    assert again.recovery.has_begun_anew
    assert held.offsets().tobytes() == whole.tobytes()


def test_a_weights_file_that_is_merely_written_again_goes_on(held, weights, tmp_path):
    settings = controlled(weights)
    stopped(held, tmp_path / "cache", 5, settings)
    same = EmulatorWeights.load(weights)
    EmulatorWeights(same.parameters, same.trained_on, {"note": "of another day"}).save(weights)
    again = begun(held, tmp_path / "cache", settings)
    completed(again)
    assert again.recovery.resumed_from == 5


@pytest.mark.parametrize("output", ["absolute", "pc2"])
def test_it_goes_on_whatever_is_written(held, weights, tmp_path, output):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    settings = replace(controlled(weights), output=output)

    def shown():
        positions = [held.positions(frame) for frame in range(1, 9)]
        clear(held.mesh)
        return np.array(positions)

    held.bake(settings)
    whole = shown()
    stopped(held, tmp_path / "cache", 5, settings)
    again = begun(held, tmp_path / "cache", settings)
    completed(again)
    assert again.recovery.resumed_from == 5
    assert np.array_equal(shown(), whole)


def test_the_frames_before_are_not_simulated_again(character, tmp_path, monkeypatch):
    stopped(character, tmp_path / "cache", 5)
    bake = begun(character, tmp_path / "cache")
    begins = []
    motion = bake._characters[0].motion
    begin = motion.begin
    monkeypatch.setattr(motion, "begin", lambda *poses: (begins.append(poses), begin(*poses)))
    completed(bake)
    assert len(begins) == 8 - 4


def test_several_objects_go_on_together(make_character, tmp_path):
    one, two = make_character("One"), make_character("Two")
    two.armature.location.x = 5.0
    bpy.context.view_layer.update()
    whole = [baked(character) for character in (one, two)]
    objects = {character.mesh_name: SPRINGS for character in (one, two)}
    bake = Bake(bpy.context.scene, objects, None, tmp_path)
    run = bake.run()
    for _ in range(5):
        next(run)
    run.close()
    again = Bake(bpy.context.scene, dict(reversed(objects.items())), None, tmp_path)
    completed(again)
    assert again.recovery.resumed_from == 5
    for character, offsets in zip((one, two), whole, strict=True):
        assert character.offsets().tobytes() == offsets.tobytes()


@pytest.mark.parametrize("steps", [5, 11])
def test_a_search_goes_on(character, tmp_path, steps):
    with_lattice(character)
    whole = baked(character)
    first = stopped(character, tmp_path / "cache", steps)
    again = begun(character, tmp_path / "cache")
    completed(again)
    assert again.recovery.resumed_from == first.recovery.saved_frame
    assert np.abs(whole).max() > 0.01
    assert np.abs(character.offsets() - whole).max() < 1e-4 * character.size
    if steps > 8:
        done = steps - 8
        assert character.offsets()[:done].tobytes() == whole[:done].tobytes()


def other_animation(character):
    character.armature.pose.bones["Upper"].rotation_euler.x = 0.4
    character.armature.pose.bones["Upper"].keyframe_insert("rotation_euler", frame=2)


def other_place(character):
    character.armature.location.z += 0.5
    bpy.context.view_layer.update()


def other_mesh(character):
    character.mesh.data.vertices[5].co.x += 0.05


def other_paint(character):
    write_group(character.mesh, PINS_GROUP, np.full(len(character.mesh.data.vertices), 0.5))


def other_weights(character):
    character.mesh.vertex_groups["Upper"].add([20], 0.3, "REPLACE")


def other_learned_springs(character):
    count = len(character.mesh.data.vertices)
    write_learned(character.mesh, LearnedSprings(np.full(count, 90.0), np.full(count, 4.0), np.full(count, 60.0), 0.25))


def other_frame_rate(character):
    bpy.context.scene.render.fps = 30


@pytest.mark.parametrize(
    "change",
    [
        other_animation,
        other_place,
        other_mesh,
        other_paint,
        other_weights,
        other_learned_springs,
        other_frame_rate,
    ],
)
def test_a_stale_cache_is_recognised(character, tmp_path, change):
    stopped(character, tmp_path / "cache", 5)
    change(character)
    whole = baked(character)
    again = begun(character, tmp_path / "cache")
    completed(again)
    assert again.recovery.resumed_from is None
    assert again.recovery.has_begun_anew
    assert character.offsets().tobytes() == whole.tobytes()


def test_other_settings_begin_anew(character, tmp_path):
    stopped(character, tmp_path, 5)
    whole = baked(character, FLESH)
    again = begun(character, tmp_path, FLESH)
    completed(again)
    assert again.recovery.has_begun_anew
    assert character.offsets().tobytes() == whole.tobytes()


def cut_frames(path):
    frames = next(path.parent.glob("*.simulated"))
    frames.write_bytes(frames.read_bytes()[:-4])


def turned_bit(path):
    frames = next(path.parent.glob("*.simulated"))
    content = bytearray(frames.read_bytes())
    content[100] ^= 1
    frames.write_bytes(content)


def missing_frames(path):
    next(path.parent.glob("*.simulated")).unlink()


def cut_states(path):
    path.write_bytes(path.read_bytes()[:-200])


def foreign_file(path):
    path.write_bytes(b"PK nothing of ours")


def foreign_arrays(path):
    np.savez(path, header=np.frombuffer(b'{"format": 1, "objects": [3]}', dtype=np.uint8))


def empty_file(path):
    path.write_bytes(b"")


@pytest.mark.parametrize(
    "spoil", [cut_frames, turned_bit, missing_frames, cut_states, foreign_file, foreign_arrays, empty_file]
)
def test_a_broken_cache_is_recognised(character, tmp_path, spoil):
    whole = baked(character)
    folder = tmp_path / "cache"
    stopped(character, folder, 5)
    spoil(next(folder.glob("*.npz")))
    again = begun(character, folder)
    completed(again)
    assert again.recovery.has_begun_anew
    assert character.offsets().tobytes() == whole.tobytes()
    assert not folder.exists()


def test_frames_that_were_written_after_the_last_state_do_no_harm(character, tmp_path):
    """As a crash between the two leaves them."""
    whole = baked(character)
    stopped(character, tmp_path, 5)
    frames = next(tmp_path.glob("*.simulated"))
    frames.write_bytes(frames.read_bytes() + b"half a frame")
    again = begun(character, tmp_path)
    completed(again)
    assert again.recovery.resumed_from == 5
    assert character.offsets().tobytes() == whole.tobytes()


def test_what_is_not_ours_stays_in_the_folder(character, tmp_path):
    (tmp_path / "notes.txt").write_text("keep")
    stopped(character, tmp_path, 5)
    completed(begun(character, tmp_path))
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_where_nothing_can_be_written_the_bake_goes_on(character, tmp_path):
    folder = tmp_path / "file"
    folder.write_text("no folder")
    bake = begun(character, folder)
    completed(bake)
    assert bake.recovery.problem
    assert np.abs(character.offsets()).max() > 0.01


def test_a_short_bake_writes_nothing(character, tmp_path, monkeypatch):
    monkeypatch.setattr(bake_recovery, "SAVE_INTERVAL", 60.0)
    bake = stopped(character, tmp_path / "cache", 7)
    assert bake.recovery.saved_frame is None
    assert not (tmp_path / "cache").exists()


def test_the_panel_can_tell_without_reading_meshes(character, tmp_path):
    scene = bpy.context.scene
    stopped(character, tmp_path, 5)
    objects = {character.mesh_name: SPRINGS}
    assert resumable_frame(tmp_path, scene, objects, FrameRange()) == 5
    assert resumable_frame(tmp_path, scene, objects, FrameRange(start=1, end=8)) == 5
    assert resumable_frame(tmp_path, scene, objects, FrameRange(end=7)) is None
    assert resumable_frame(tmp_path, scene, {character.mesh_name: FLESH}, FrameRange()) is None
    BakeCache(tmp_path, scene.name, objects).remove()
    assert resumable_frame(tmp_path, scene, objects, FrameRange()) is None


def test_caches_lie_beside_their_file(tmp_path):
    assert cache_folder().name == "followthrough_cache"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert cache_folder() == tmp_path / "shot_followthrough_cache"
    assert cache_folder(tmp_path / "nowhere" / "shot.blend").name == "followthrough_cache"
