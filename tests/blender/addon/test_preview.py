# SPDX-License-Identifier: GPL-3.0-or-later
"""The live preview shows what a bake would, follows the timeline, and leaves nothing behind, whatever happens to the file meanwhile."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough.blender import PINS_GROUP, preview, write_group

from .file_contents import contents, keys

PREVIEW = "Followthrough Preview"


def offsets(obj: bpy.types.Object) -> NDArray[np.float32]:
    """What the preview adds to the rest shape, (v, 3)."""
    blocks = obj.data.shape_keys.key_blocks
    found = np.empty((2, len(obj.data.vertices) * 3), dtype=np.float32)
    for row, name in zip(found, (blocks[0].name, PREVIEW), strict=True):
        blocks[name].points.foreach_get("co", row)
    return (found[1] - found[0]).reshape(-1, 3)


def evaluated(obj: bpy.types.Object) -> NDArray[np.float32]:
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    positions = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", positions)
    return positions.reshape(-1, 3)


def baked(obj: bpy.types.Object, frames: range) -> list[NDArray[np.float32]]:
    """What a bake shows in the frames, which is cleared again."""
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated(obj))
    assert bpy.ops.followthrough.clear() == {"FINISHED"}
    return shown


def played(obj: bpy.types.Object, frames: range) -> list[NDArray[np.float32]]:
    shown = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        shown.append(evaluated(obj))
    return shown


def on(frame: int = 1) -> None:
    bpy.context.scene.frame_set(frame)
    assert bpy.ops.followthrough.preview() == {"FINISHED"}


def test_the_preview_is_the_bake_to_the_bit(painted: bpy.types.Object) -> None:
    painted.followthrough.solver = "implicit-euler"
    frames = range(1, 13)
    expected = baked(painted, frames)
    on()
    found = played(painted, frames)
    assert np.abs(found[6] - played(painted, range(1, 2))[0]).max() > 1e-2, "something must move"
    for bake, preview_ in zip(expected, found, strict=True):
        assert np.array_equal(bake, preview_)


def test_springs_lack_only_their_look_ahead(painted: bpy.types.Object) -> None:
    frames = range(1, 13)
    painted.followthrough.solver = "springs"
    expected = np.array(baked(painted, frames))
    still = np.array(played(painted, frames))
    on()
    found = np.array(played(painted, frames))
    moved = np.linalg.norm(expected - still, axis=2).max()
    assert moved > 0.02
    assert np.linalg.norm(found - expected, axis=2).max() < 0.35 * moved


def test_it_leaves_nothing_behind(painted: bpy.types.Object) -> None:
    before = contents()
    on(3)
    bpy.context.scene.frame_set(5)
    assert keys(painted) == ["Basis", PREVIEW]
    bpy.context.scene.frame_set(3)
    assert bpy.ops.followthrough.preview() == {"FINISHED"}
    assert contents() == before
    assert not [handler for handler in bpy.app.handlers.frame_change_post if "followthrough" in handler.__module__]


def test_other_keys_and_an_earlier_bake_are_as_before(painted: bpy.types.Object) -> None:
    painted.shape_key_add(name="Basis")
    smile = painted.shape_key_add(name="Smile")
    smile.data[0].co.x += 0.1
    smile.value = 0.0
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    painted.active_shape_key_index = 1
    bpy.context.scene.frame_set(3)
    before, shown = contents(), evaluated(painted)
    on(3)
    bpy.context.scene.frame_set(4)
    muted = [block.name for block in painted.data.shape_keys.key_blocks if block.mute]
    assert len(muted) == 12, "the bake does not show beside the preview"
    assert painted.active_shape_key.name == "Smile"
    bpy.context.scene.frame_set(3)
    bpy.ops.followthrough.preview()
    assert contents() == before
    assert not [block.name for block in painted.data.shape_keys.key_blocks if block.mute]
    assert np.array_equal(evaluated(painted), shown)


@pytest.mark.parametrize("output", ["absolute", "keys"])
def test_bakes_of_every_kind_come_back(painted: bpy.types.Object, output: str) -> None:
    painted.followthrough.output = output
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    expected = played(painted, range(1, 13))
    on()
    played(painted, range(1, 6))
    bpy.ops.followthrough.preview()
    assert np.array_equal(played(painted, range(1, 13)), expected)


def test_the_timeline_jumping_back_begins_anew(painted: bpy.types.Object) -> None:
    on()
    played(painted, range(1, 9))
    assert np.abs(offsets(painted)).max() > 1e-3
    bpy.context.scene.frame_set(4)
    assert not offsets(painted).any()
    first = played(painted, range(1, 9))
    assert np.array_equal(played(painted, range(1, 9)), first)


def test_a_jump_far_ahead_begins_anew_and_a_few_frames_left_out_do_not(painted: bpy.types.Object) -> None:
    on()
    played(painted, range(1, 5))
    bpy.context.scene.frame_set(4 + preview.MOST_LEFT_OUT + 2)
    assert not offsets(painted).any()
    played(painted, range(1, 5))
    bpy.context.scene.frame_set(6)
    left_out = offsets(painted).copy()
    played(painted, range(1, 7))
    whole = offsets(painted)
    # On the way between two poses in equal steps: another motion, but one that goes on.
    assert 0.5 * np.abs(whole).max() < np.abs(left_out).max() < 4.0 * np.abs(whole).max()


def test_a_cycle_goes_on_at_its_end(painted: bpy.types.Object) -> None:
    painted.followthrough.use_loop = True
    on()
    played(painted, range(1, 13))
    end = offsets(painted).copy()
    assert end.any()
    bpy.context.scene.frame_set(1)
    # The pose of the last frame is the first one's: nothing moves on.
    assert np.array_equal(offsets(painted), end)
    bpy.context.scene.frame_set(2)
    assert offsets(painted).any()


def test_settings_take_effect_at_once(painted: bpy.types.Object) -> None:
    on()
    played(painted, range(1, 6))
    painted.followthrough.amplitude = 0.0
    bpy.context.scene.frame_set(6)
    played(painted, range(6, 9))
    assert not offsets(painted).any()


def test_paint_takes_effect_at_the_start(painted: bpy.types.Object, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preview, "_REST", 0.0)
    on()
    played(painted, range(1, 9))
    assert offsets(painted).any()
    write_group(painted, PINS_GROUP, np.ones(len(painted.data.vertices)))
    played(painted, range(1, 9))
    assert not offsets(painted).any()


def test_saved_files_have_no_preview(addon: ModuleType, painted: bpy.types.Object, tmp_path: Path) -> None:
    on()
    played(painted, range(1, 5))
    shown = offsets(painted).copy()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"), check_existing=False, copy=True)
    assert np.array_equal(offsets(painted), shown), "it goes on after saving"
    with bpy.data.libraries.load(str(tmp_path / "shot.blend")) as (_, wanted):
        wanted.objects = [painted.name]
    assert keys(wanted.objects[0]) == []
    name = painted.name
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    assert addon.preview.running() is None
    assert keys(bpy.data.objects[name]) == []
    bpy.context.scene.frame_set(2)
    assert keys(bpy.data.objects[name]) == []


def test_disabling_the_add_on_ends_it(addon: ModuleType, painted: bpy.types.Object) -> None:
    before = contents()
    on(3)
    addon.unregister()
    assert contents() == before
    lists = [getattr(bpy.app.handlers, name) for name in dir(bpy.app.handlers) if not name.startswith("_")]
    there = [handler for found in lists if isinstance(found, list) for handler in found]
    assert not [handler for handler in there if "followthrough" in handler.__module__]
    addon.register()


def test_undo_brings_no_preview_back(addon: ModuleType, painted: bpy.types.Object) -> None:
    name = painted.name
    bpy.ops.ed.undo_push(message="Before")
    on()
    played(painted, range(1, 4))
    bpy.context.scene.render.resolution_x = 640
    bpy.ops.ed.undo_push(message="Meanwhile")
    bpy.context.scene.render.resolution_x = 320
    played(bpy.data.objects[name], range(1, 6))
    bpy.ops.ed.undo_push(message="Later")
    addon.preview.end()
    bpy.ops.ed.undo()
    assert bpy.context.scene.render.resolution_x == 640
    assert keys(bpy.data.objects[name]) == []
    bpy.ops.ed.undo()
    assert keys(bpy.data.objects[name]) == []


def test_undo_meanwhile_goes_on(addon: ModuleType, painted: bpy.types.Object) -> None:
    name = painted.name
    bpy.ops.ed.undo_push(message="Before")
    bpy.context.scene.render.resolution_x = 640
    bpy.ops.ed.undo_push(message="After")
    on()
    played(painted, range(1, 4))
    bpy.ops.ed.undo()
    found = bpy.data.objects[name]
    played(found, range(1, 6))
    assert addon.preview.running() is not None
    assert offsets(found).any()
    addon.preview.end()
    assert keys(found) == []


def test_rendering_shows_what_was_there_before(addon: ModuleType, painted: bpy.types.Object) -> None:
    """The handlers alone: the module has no engine that renders without a display."""
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    bpy.context.scene.frame_set(5)
    shown = evaluated(painted)
    on()
    played(painted, range(1, 6))
    for handler in bpy.app.handlers.render_init:
        handler(bpy.context.scene)
    bpy.context.scene.frame_set(6)
    bpy.context.scene.frame_set(5)
    assert np.array_equal(evaluated(painted), shown)
    for handler in bpy.app.handlers.render_complete:
        handler(bpy.context.scene)
    played(painted, range(5, 7))
    blocks = painted.data.shape_keys.key_blocks
    assert not blocks[PREVIEW].mute and blocks["Followthrough 0005"].mute


def test_a_bake_ends_it(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    before = contents()
    on(3)
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    assert addon.preview.running() is None
    assert contents() == before


def test_clear_and_remove_end_it(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    on()
    assert bpy.ops.followthrough.clear() == {"FINISHED"}
    assert addon.preview.running() is None and keys(painted) == []
    on()
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert addon.preview.running() is None and keys(painted) == []


def hide_armature_modifier(obj: bpy.types.Object) -> None:
    obj.modifiers["Armature"].show_viewport = False


def add_smoothing(obj: bpy.types.Object) -> None:
    obj.modifiers.new("Smooth", "SMOOTH")


def share_mesh(obj: bpy.types.Object) -> None:
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Twin", obj.data))


def rest_position(obj: bpy.types.Object) -> None:
    obj.parent.data.pose_position = "REST"


def edit_mode(obj: bpy.types.Object) -> None:
    bpy.ops.object.mode_set(mode="EDIT")


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (hide_armature_modifier, "switched off"),
        (add_smoothing, "it can be baked"),
        (share_mesh, "shares its mesh"),
        (rest_position, "Rest Position"),
        (edit_mode, "Edit Mode"),
    ],
)
def test_what_cannot_be_previewed_says_why(
    painted: bpy.types.Object, spoil: Callable[[bpy.types.Object], None], words: str
) -> None:
    spoil(painted)
    before = contents()
    assert not bpy.ops.followthrough.preview.poll()
    assert words in (preview.why_not_previewable(painted) or "")
    assert contents() == before


def test_flesh_that_nothing_holds_is_an_error_in_words(painted: bpy.types.Object) -> None:
    painted.followthrough.solver = "implicit-euler"
    painted.followthrough.cells = 4
    painted.followthrough.pin_groups.clear()
    painted.data.transform(__import__("mathutils").Matrix.Translation((5.0, 0.0, 0.0)))  # no bone is near
    before = contents()
    with pytest.raises(RuntimeError, match="pins"):
        bpy.ops.followthrough.preview()
    assert contents() == before


def test_an_object_that_goes_ends_it_with_the_reason(addon: ModuleType, painted: bpy.types.Object) -> None:
    on()
    bpy.data.objects.remove(painted)
    bpy.context.scene.frame_set(2)
    assert addon.preview.running() is None
    assert "removed" in addon.preview.live.why_ended()


def test_a_renamed_object_ends_it_without_a_trace(addon: ModuleType, painted: bpy.types.Object) -> None:
    on()
    played(painted, range(1, 4))
    painted.name = "Pillar"
    bpy.context.scene.frame_set(4)
    assert addon.preview.running() is None
    assert "renamed" in addon.preview.live.why_ended()
    assert keys(painted) == []


def test_edit_mode_meanwhile_is_left_alone(addon: ModuleType, painted: bpy.types.Object) -> None:
    on()
    played(painted, range(1, 4))
    bpy.ops.object.mode_set(mode="EDIT")
    played(painted, range(4, 6))
    bpy.ops.object.mode_set(mode="OBJECT")
    played(painted, range(6, 8))
    assert offsets(painted).any()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.followthrough.preview()
    assert painted.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert keys(painted) == []


def test_it_says_how_fast_it_is(addon: ModuleType, painted: bpy.types.Object) -> None:
    on()
    running = addon.preview.running()
    assert addon.preview.live.figures(running) == "Play the timeline"
    played(painted, range(1, 9))
    assert running.milliseconds > 0.0 and running.frames_per_second > 0.0
    assert "frames a second" in addon.preview.live.figures(running)


@pytest.mark.parametrize("plays", [False, True])
def test_the_button_stops_the_playback_that_it_has_started(
    addon: ModuleType, painted: bpy.types.Object, plays: bool
) -> None:
    screen, button = bpy.context.screen, addon.preview.operator.play_or_stop
    if plays:
        bpy.ops.screen.animation_play()
    bpy.ops.followthrough.preview()
    button(screen)
    assert screen.is_animation_playing
    bpy.ops.followthrough.preview()
    button(screen)
    assert screen.is_animation_playing == plays
    bpy.ops.screen.animation_cancel()
