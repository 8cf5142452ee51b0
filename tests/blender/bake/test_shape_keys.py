# SPDX-License-Identifier: GPL-3.0-or-later
"""Our shape keys live beside those of others and go without a trace."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from followthrough.blender import FrameRange, actions, clear, shape_keys


def random_offsets(character, frames=8):
    generator = np.random.default_rng(1)
    return generator.normal(size=(frames, len(character.mesh.data.vertices), 3)).astype(np.float32) * 0.05


def add_foreign_keys(character):
    mesh = character.mesh
    mesh.shape_key_add(name="Basis")
    for name, factor in (("Smile", 1.2), ("Frown", 0.8)):
        block = mesh.shape_key_add(name=name, from_mix=False)
        block.value = 0.25
        for point in block.data:
            point.co.x *= factor
    mesh.active_shape_key_index = 2


def foreign_state(character):
    """Everything about shape keys that is not ours."""
    key = character.mesh.data.shape_keys
    if key is None:
        return None
    ours = shape_keys.our_names(key)
    animation = key.animation_data
    own = animation is not None and animation.action is not None and not actions.is_ours(animation.action)
    return (
        [
            (b.name, b.value, b.mute, b.relative_key.name, shape_keys.read_points(b).tobytes())
            for b in key.key_blocks
            if b.name not in ours
        ],
        character.mesh.active_shape_key.name,
        animation.action.name if own else None,
        [driver.data_path for driver in animation.drivers] if animation is not None else [],
        [track.name for track in animation.nla_tracks if track.name != actions.OURS] if animation is not None else [],
    )


def nothing(character):
    pass


def animate(character):
    block = character.mesh.data.shape_keys.key_blocks["Smile"]
    for frame, value in ((1, 0.0), (8, 1.0)):
        block.value = value
        block.keyframe_insert("value", frame=frame)
    bpy.context.scene.frame_set(1)


def drive(character):
    block = character.mesh.data.shape_keys.key_blocks["Frown"]
    block.driver_add("value").driver.expression = "frame / 10"
    bpy.context.scene.frame_set(1)


def animate_by_track(character):
    animate(character)
    animation = character.mesh.data.shape_keys.animation_data
    track = animation.nla_tracks.new()
    track.name = "Mine"
    slot = getattr(animation, "action_slot", None)
    strip = track.strips.new("Mine", 1, animation.action)
    if slot is not None:
        strip.action_slot = slot
    animation.action = None


@pytest.mark.parametrize("prepare", [nothing, animate, drive, animate_by_track])
def test_foreign_keys_and_animation_are_untouched(character, prepare):
    add_foreign_keys(character)
    prepare(character)
    scene = bpy.context.scene
    before, number = foreign_state(character), len(bpy.data.actions)
    values = {}
    for frame in range(0, 11):
        scene.frame_set(frame)
        values[frame] = [character.mesh.data.shape_keys.key_blocks[name].value for name in ("Smile", "Frown")]
    scene.frame_set(1)
    for _ in range(2):
        shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
        scene.frame_set(1)
        assert foreign_state(character) == before
        assert len(bpy.data.actions) == number + 1
        key = character.mesh.data.shape_keys
        for frame in range(0, 11):
            scene.frame_set(frame)
            assert [key.key_blocks[name].value for name in ("Smile", "Frown")] == values[frame]
            shown = [block.value for block in key.key_blocks if block.name in shape_keys.our_names(key)]
            assert shown == [float(frame == own) for own in range(1, 9)]
        scene.frame_set(1)
    assert clear(character.mesh)
    assert foreign_state(character) == before
    assert len(bpy.data.actions) == number
    assert len(character.mesh.data.shape_keys.key_blocks) == 3
    assert (character.mesh.data.shape_keys.animation_data is None) == (prepare is nothing)


def test_clear_leaves_a_mesh_without_keys_as_it_was(character):
    number = len(bpy.data.actions)
    positions = character.positions(4)
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    assert clear(character.mesh)
    assert character.mesh.data.shape_keys is None
    assert len(bpy.data.actions) == number
    assert np.array_equal(character.positions(4), positions)
    assert not clear(character.mesh)


def test_clear_keeps_a_basis_that_others_need(character):
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    character.mesh.shape_key_add(name="Smile")
    shape_keys.write(character.mesh, range(1, 5), random_offsets(character, 4))
    clear(character.mesh)
    assert character.mesh.data.shape_keys.key_blocks.keys() == ["Basis", "Smile"]


def test_clear_keeps_a_basis_that_was_there(character):
    character.mesh.shape_key_add(name="Basis")
    for _ in range(2):
        shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    clear(character.mesh)
    assert character.mesh.data.shape_keys.key_blocks.keys() == ["Basis"]


def test_clear_finds_keys_that_were_renamed(character):
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    character.mesh.data.shape_keys.key_blocks["Followthrough 0003"].name = 'Odd "name"'
    clear(character.mesh)
    assert character.mesh.data.shape_keys is None


def test_a_foreign_key_with_our_name_stays(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.shape_key_add(name="Followthrough 0003")
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    clear(character.mesh)
    assert character.mesh.data.shape_keys.key_blocks.keys() == ["Basis", "Followthrough 0003"]


def test_what_others_keyed_into_our_action_stays(character):
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    smile = character.mesh.shape_key_add(name="Smile")
    smile.value = 0.5
    smile.keyframe_insert("value", frame=1)
    character.mesh.location.x = 2.0
    character.mesh.keyframe_insert("location", frame=1)  # Blender 4.4 and later put it into the same action
    for _ in range(2):
        shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    clear(character.mesh)
    smile.value = 0.0
    character.mesh.location.x = 0.0
    bpy.context.scene.frame_set(2)
    assert character.mesh.data.shape_keys.key_blocks["Smile"].value == 0.5
    assert character.mesh.location.x == 2.0
    assert not any(action.name.startswith("Followthrough") for action in bpy.data.actions)


def test_a_copied_character_keeps_its_bake(make_character):
    character = make_character()
    shape_keys.write(character.mesh, range(1, 9), random_offsets(character))
    copy = character.mesh.copy()
    copy.data = character.mesh.data.copy()
    bpy.context.scene.collection.objects.link(copy)
    clear(character.mesh)
    bpy.context.scene.frame_set(3)
    assert copy.data.shape_keys.key_blocks["Followthrough 0003"].value == 1.0
    clear(copy)
    assert copy.data.shape_keys is None
    assert not any(action.name.startswith("Followthrough") for action in bpy.data.actions)


def test_keys_are_relative_and_curves_linear(character):
    character.bake(frames=FrameRange(start=2, end=5))
    key = character.mesh.data.shape_keys
    assert key.use_relative
    assert all(block.relative_key == key.key_blocks[0] for block in key.key_blocks)
    curves = list(actions._curves(key.animation_data.action))
    assert len(curves) == 4
    for frame, curve in enumerate(curves, start=2):
        points = [(tuple(point.co), point.interpolation) for point in curve.keyframe_points]
        assert points == [((frame - 1, 0), "LINEAR"), ((frame, 1), "LINEAR"), ((frame + 1, 0), "LINEAR")]


def test_it_survives_saving_and_plays_after_reload(character, tmp_path):
    character.bake()
    expected = [character.positions(frame) for frame in range(0, 10)]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "baked.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "baked.blend"))
    for frame, positions in enumerate(expected):
        assert np.array_equal(character.positions(frame), positions)
    assert clear(character.mesh)


def test_offsets_that_do_not_fit_change_nothing(character):
    with pytest.raises(ValueError, match="offsets"):
        shape_keys.write(character.mesh, range(1, 9), random_offsets(character)[:, :-1])
    assert character.mesh.data.shape_keys is None
