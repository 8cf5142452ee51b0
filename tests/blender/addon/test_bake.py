# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, Clear, cancelling and refusing: what the file has in it afterwards."""

from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough.blender import bake_recovery

from .file_contents import contents, keys, points


def running_bake(addon: ModuleType, obj: bpy.types.Object) -> Any:
    """A bake as the operator begins it in a window."""
    settings = addon.properties.bake_settings
    objects = {obj.name: settings.object_settings(obj)}
    return addon.bake.session.BakeSession(bpy.context.scene, objects, settings.frame_range(obj))


def test_bake_writes_a_key_a_frame(painted: bpy.types.Object) -> None:
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    assert keys(painted) == ["Basis", *(f"Followthrough {frame:04d}" for frame in range(1, 13))]
    offsets = points(painted)[1:] - points(painted)[0]
    assert np.abs(offsets).max() > 1e-3
    assert bpy.context.scene.frame_current == 3


def test_simulation_is_the_other_solver_of_the_same_bake(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    springs = points(painted)
    painted.followthrough.solver = "implicit-euler"
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    assert points(painted).shape == springs.shape
    assert np.abs(points(painted) - points(painted)[0]).max() > 1e-3
    assert np.abs(points(painted) - springs).max() > 1e-3


def test_flesh_that_nothing_holds_is_an_error_in_words(painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.solver = "implicit-euler"
    settings.cells = 2  # so coarse that no vertex is inside, where the bones would hold it
    settings.pin_groups.clear()
    with pytest.raises(RuntimeError, match=r"Column.*paint pins where the character follows its bones"):
        bpy.ops.followthrough.bake()
    assert keys(painted) == []


def test_what_is_baked_plays(painted: bpy.types.Object) -> None:
    """With the keys, the evaluated mesh is elsewhere than the armature alone puts it."""
    bpy.ops.followthrough.bake()

    def evaluated(frame: int) -> NDArray[np.float64]:
        bpy.context.scene.frame_set(frame)
        mesh = painted.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        return np.array([vertex.co[:] for vertex in mesh.vertices])

    dynamic = evaluated(6)
    bpy.ops.followthrough.clear()
    assert np.abs(dynamic - evaluated(6)).max() > 1e-3


def test_baking_again_gives_the_same(painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    first, blocks = points(painted), sorted(bpy.data.actions.keys())
    bpy.ops.followthrough.bake()
    np.testing.assert_array_equal(points(painted), first)
    assert sorted(bpy.data.actions.keys()) == blocks


def test_settings_reach_the_bake(painted: bpy.types.Object) -> None:
    def largest() -> float:
        bpy.ops.followthrough.bake()
        return float(np.abs(points(painted)[1:] - points(painted)[0]).max())

    soft = largest()
    painted.followthrough.frequency_stiff = painted.followthrough.frequency_soft = 50.0
    assert largest() < 0.2 * soft


def test_a_custom_range_is_kept_to(painted: bpy.types.Object) -> None:
    settings = painted.followthrough
    settings.frame_range, settings.frame_start, settings.frame_end = "CUSTOM", 5, 8
    bpy.ops.followthrough.bake()
    assert keys(painted)[1:] == [f"Followthrough {frame:04d}" for frame in range(5, 9)]


def test_a_loop_leads_into_its_start(painted: bpy.types.Object) -> None:
    painted.followthrough.use_loop = True
    painted.followthrough.cycles = 4
    bpy.ops.followthrough.bake()
    offsets = points(painted)[1:] - points(painted)[0]
    assert np.abs(offsets[0]).max() > 1e-4, "a loop's first frame carries on from its last"


def test_selected_characters_are_baked_together(painted: bpy.types.Object) -> None:
    other = painted.copy()
    other.data = painted.data.copy()
    bpy.context.scene.collection.objects.link(other)
    other.select_set(True)
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    assert len(keys(painted)) == len(keys(other)) == 13
    assert bpy.ops.followthrough.clear() == {"FINISHED"}
    assert keys(painted) == keys(other) == []


def test_clear_restores(painted: bpy.types.Object) -> None:
    before = contents()
    bpy.ops.followthrough.bake()
    assert contents() != before
    assert bpy.ops.followthrough.clear() == {"FINISHED"}
    assert contents() == before
    assert not bpy.ops.followthrough.clear.poll()


def test_clear_keeps_the_keys_of_others(painted: bpy.types.Object) -> None:
    painted.shape_key_add(name="Basis")
    painted.shape_key_add(name="Smile").points[0].co.x += 0.1
    before = contents()
    bpy.ops.followthrough.bake()
    bpy.ops.followthrough.clear()
    assert contents() == before


@pytest.mark.parametrize("slices", [0, 1, 5])
@pytest.mark.parametrize("baked_before", [False, True])
def test_cancel_restores(addon: ModuleType, painted: bpy.types.Object, slices: int, baked_before: bool) -> None:
    if baked_before:
        bpy.ops.followthrough.bake()
        bpy.context.scene.frame_set(7)
    before = contents()
    bake = running_bake(addon, painted)
    for _ in range(slices):
        assert not bake.advance(0.0)
    assert bake.done == slices
    bake.cancel()
    assert contents() == before
    assert addon.bake.session.running() is None


def test_cancel_puts_edit_mode_back(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.object.mode_set(mode="EDIT")
    bake = running_bake(addon, painted)
    bake.advance(0.0)
    bake.cancel()
    assert painted.mode == "EDIT"


def test_disabling_the_add_on_cancels(addon: ModuleType, painted: bpy.types.Object) -> None:
    before = contents()
    bake = running_bake(addon, painted)
    bake.advance(0.0)
    addon.unregister()
    addon.register()
    assert contents() == before
    assert addon.bake.session.running() is None


def test_only_one_bake_at_a_time(addon: ModuleType, painted: bpy.types.Object) -> None:
    bake = running_bake(addon, painted)
    assert not bpy.ops.followthrough.bake.poll()
    assert not bpy.ops.followthrough.clear.poll()
    with pytest.raises(ValueError, match="under way"):
        running_bake(addon, painted)
    bake.cancel()
    assert bpy.ops.followthrough.bake.poll()


def test_slices_give_what_a_bake_at_once_gives(addon: ModuleType, painted: bpy.types.Object) -> None:
    bpy.ops.followthrough.bake()
    at_once = points(painted)
    bake = running_bake(addon, painted)
    statuses = [bake.status()]
    while not bake.advance(0.0):
        statuses.append(bake.status())
    assert bake.status() == "Writing shape keys"
    bake.finish()
    np.testing.assert_array_equal(points(painted), at_once)
    assert statuses[0] == f"Baking frame 1 of {bake.total}"
    assert statuses[4].startswith(f"Baking frame 5 of {bake.total}, 0:0")
    assert statuses[4].endswith(" left")


@pytest.fixture
def cached(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Every frame goes to the cache of a file that is saved here."""
    monkeypatch.setattr(bake_recovery, "SAVE_INTERVAL", 0.0)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    return tmp_path


def stopped_bake(addon: ModuleType, obj: bpy.types.Object) -> int | None:
    bake = running_bake(addon, obj)
    while bake.done < 6:
        bake.advance(0.0)
    bake.cancel()
    frame: int | None = bake.saved_frame
    return frame


def test_a_stopped_bake_is_resumed(addon: ModuleType, painted: bpy.types.Object, cached: Path) -> None:
    name = painted.name
    bpy.ops.followthrough.bake()
    at_once = points(painted)
    bpy.ops.followthrough.clear()
    before = contents()
    assert stopped_bake(addon, painted) == 6
    assert contents() == before
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)  # as after a crash
    painted = bpy.data.objects[name]
    bake = running_bake(addon, painted)
    while not bake.advance(0.0):
        pass
    bake.finish()
    assert bake.notes() == ("Resumed from frame 6",)
    np.testing.assert_array_equal(points(painted), at_once)
    assert [path.name for path in cached.iterdir() if path.is_dir()] == []


def test_the_time_left_counts_from_where_a_bake_goes_on(
    addon: ModuleType, painted: bpy.types.Object, cached: Path
) -> None:
    stopped_bake(addon, painted)
    bake = running_bake(addon, painted)
    while bake.notes() == ():
        bake.advance(0.0)
    assert bake.seconds_left() is None, "frames of the earlier bake say nothing about those to come"
    bake.advance(0.0)
    assert bake.seconds_left() is not None
    bake.cancel()


def test_a_stopped_bake_can_be_discarded(addon: ModuleType, painted: bpy.types.Object, cached: Path) -> None:
    assert not bpy.ops.followthrough.discard_stopped_bake.poll()
    stopped_bake(addon, painted)
    assert (cached / "shot_followthrough_cache").is_dir()
    assert bpy.ops.followthrough.discard_stopped_bake() == {"FINISHED"}
    assert not (cached / "shot_followthrough_cache").exists()
    assert not bpy.ops.followthrough.discard_stopped_bake.poll()


def test_a_stopped_bake_of_other_paint_begins_anew(addon: ModuleType, painted: bpy.types.Object, cached: Path) -> None:
    stopped_bake(addon, painted)
    painted.vertex_groups["Followthrough Pins"].add([0, 1, 2], 0.5, "REPLACE")
    bake = running_bake(addon, painted)
    while not bake.advance(0.0):
        pass
    bake.finish()
    (note,) = bake.notes()
    assert "has changed" in note
    assert [path.name for path in cached.iterdir() if path.is_dir()] == []


def test_a_missing_pin_group_is_an_error(painted: bpy.types.Object) -> None:
    painted.vertex_groups.remove(painted.vertex_groups["Followthrough Pins"])
    before = contents()
    for operator in (bpy.ops.followthrough.bake, bpy.ops.followthrough.learn, bpy.ops.followthrough.preview):
        with pytest.raises(
            RuntimeError, match=r"'Followthrough Pins' any more.*choose another one under Paint, Pin Groups"
        ):
            operator()
    assert contents() == before
    painted.followthrough.pin_groups[0].name = ""
    with pytest.raises(RuntimeError, match="no vertex group is chosen: choose another one"):
        bpy.ops.followthrough.bake()


def test_an_error_halfway_is_reported_and_restores(
    addon: ModuleType, painted: bpy.types.Object, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents()
    frames = addon.bake.session.Bake.run

    def breaks(self: Any, **options: Any) -> Any:
        for progress in frames(self, **options):
            yield progress
            if progress.done == 3:
                raise ValueError("Column: frame 3 is not finite")

    monkeypatch.setattr(addon.bake.session.Bake, "run", breaks)
    with pytest.raises(RuntimeError, match="frame 3 is not finite"):
        bpy.ops.followthrough.bake()
    assert contents() == before
    assert addon.bake.session.running() is None


def test_a_shared_mesh_is_refused(painted: bpy.types.Object) -> None:
    twin = bpy.data.objects.new("Twin", painted.data)
    bpy.context.scene.collection.objects.link(twin)
    assert not bpy.ops.followthrough.bake.poll()


def test_undo_takes_the_whole_bake_back(painted: bpy.types.Object) -> None:
    bpy.ops.ed.undo_push(message="Before")
    name = painted.name
    bpy.ops.followthrough.bake()
    bpy.ops.ed.undo_push(message="Bake Followthrough")
    assert len(keys(bpy.data.objects[name])) == 13
    bpy.ops.ed.undo()
    assert keys(bpy.data.objects[name]) == []
    assert bpy.context.scene.frame_current == 3
    bpy.ops.ed.redo()
    assert len(keys(bpy.data.objects[name])) == 13
