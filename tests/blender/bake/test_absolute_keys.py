# SPDX-License-Identifier: GPL-3.0-or-later
"""Absolute shape keys play what relative ones play, and go without a trace."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import Bake, FrameRange, NotBakeableError, ObjectSettings, baked_range, clear
from followthrough.cli import main
from followthrough.settings import Settings, SpringSettings, VolumeSettings

MOTION = Settings(
    solver="springs", volume=VolumeSettings(cells=8), springs=SpringSettings(stiffness_range=(60.0, 60.0))
)
RELATIVE = ObjectSettings(motion=MOTION)
ABSOLUTE = ObjectSettings(motion=MOTION, output="absolute")


def plain(character):
    pass


def own_basis(character):
    character.mesh.shape_key_add(name="Mine")


def remapped_time(character):
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 300, 200


def smoothed(character):
    """Offsets are searched."""
    character.mesh.modifiers.new("Smooth", "SMOOTH").factor = 0.2


@pytest.mark.parametrize("prepare", [plain, own_basis, remapped_time, smoothed])
def test_they_play_what_relative_keys_play(character, prepare):
    prepare(character)
    times = [-3, 1, 1.5, 2, 2.25, 3, 5.5, 7, 7.5, 8, 9, 20]
    frames = FrameRange(start=2, end=7)
    character.bake(RELATIVE, frames)
    expected = [character.positions(time) for time in times]
    clear(character.mesh)
    bare = [character.positions(time) for time in times]
    for _ in range(2):  # again over itself
        character.bake(ABSOLUTE, frames)
        assert not character.mesh.data.shape_keys.use_relative
        assert baked_range(character.mesh) == (2, 7)
        assert len(character.mesh.data.shape_keys.key_blocks) == 1 + 6 + 1
        for time, wanted in zip(times, expected, strict=True):
            assert np.abs(character.positions(time) - wanted).max() < 2e-5 * character.size
    assert max(np.abs(a - b).max() for a, b in zip(expected, bare, strict=True)) > 1e-3


def test_many_frames_stand_in_order(make_character):
    character = make_character(frames=300)
    character.bake(RELATIVE)
    expected = [character.positions(frame) for frame in (1, 123, 299.5, 300)]
    character.bake(ABSOLUTE)
    for frame, wanted in zip((1, 123, 299.5, 300), expected, strict=True):
        assert np.abs(character.positions(frame) - wanted).max() < 2e-5 * character.size


def test_clear_takes_them_back(character):
    before = character.positions(5)
    character.bake(ABSOLUTE)
    assert np.abs(character.positions(5) - before).max() > 1e-3
    assert clear(character.mesh)
    assert character.mesh.data.shape_keys is None
    assert not bpy.data.actions.get("Followthrough Creature")
    assert np.array_equal(character.positions(5), before)


def test_relative_keys_take_their_place(character):
    character.bake(RELATIVE)
    expected = character.positions(5)
    character.bake(ABSOLUTE)
    character.bake(RELATIVE)
    key = character.mesh.data.shape_keys
    assert key.use_relative
    assert len(key.key_blocks) == 9
    assert np.array_equal(character.positions(5), expected)


def test_a_cancelled_bake_leaves_them(character):
    character.bake(ABSOLUTE)
    shown = character.positions(5)
    run = Bake(bpy.context.scene, {character.mesh_name: RELATIVE}).run()
    next(run)
    assert character.mesh.data.shape_keys.use_relative
    run.close()
    assert not character.mesh.data.shape_keys.use_relative
    assert np.array_equal(character.positions(5), shown)


def idle_key(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.shape_key_add(name="Smile").value = 0.0
    return "'Smile'"


def foreign_absolute_keys(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.data.shape_keys.use_relative = False
    return "absolute shape keys"


@pytest.mark.parametrize("spoil", [idle_key, foreign_absolute_keys])
def test_beside_other_keys_they_are_refused(character, spoil):
    reason = spoil(character)
    with pytest.raises(NotBakeableError, match=reason):
        Bake(bpy.context.scene, {character.mesh_name: ABSOLUTE})


def test_the_command_writes_them(character, tmp_path):
    source, target = tmp_path / "in.blend", tmp_path / "out.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))
    arguments = ["bake", str(source), "-o", str(target), "--cells", "8", "--quiet", "--output-kind", "absolute"]
    assert main(arguments) == 0
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert not character.mesh.data.shape_keys.use_relative
    shown = character.positions(5)
    clear(character.mesh)
    assert np.abs(shown - character.positions(5)).max() > 1e-3
