# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be kept on a mesh of another file is refused with the reason, and nothing is changed."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import bpy
import pytest

from followthrough.blender import has_learned, why_not_bakeable

from .conftest import link_into_new_file, make_local

OPERATORS = {
    "heat map": ("show_heat_map", {"quantity": "stiffness"}),
    "forget": ("forget_learned", {}),
    "learn": ("learn", {}),
    "paint": ("paint", {"target": "STIFFNESS"}),
    "pin group": ("add_pin_group", {}),
    "preview": ("preview", {}),
}


def linked(addon: ModuleType, obj: bpy.types.Object, folder: Path, override: bool) -> bpy.types.Object:
    """A character that has learned, in a new file: a local object with its linked mesh, or overrides of both."""
    assert bpy.ops.followthrough.learn() == {"FINISHED"}
    objects = link_into_new_file(addon, obj, folder)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 12
    if not override:
        here = make_local(objects)
    else:
        character, armature = objects
        here = character.override_create(remap_local_usages=True)
        here.data.override_create(remap_local_usages=True)
        for other in (here, armature):
            scene.collection.objects.link(other)
            other.select_set(True)
        bpy.context.view_layer.objects.active = here
    here.followthrough.is_added = True
    return here


def contents(obj: bpy.types.Object) -> tuple[object, ...]:
    mesh = obj.data
    return (
        sorted(mesh.attributes.keys()),
        sorted(mesh.color_attributes.keys()),
        [group.name for group in obj.vertex_groups],
        mesh.shape_keys,
        obj.mode,
        has_learned(obj),
        sorted(mesh.keys()),
    )


@pytest.mark.parametrize("override", [False, True], ids=["linked", "override"])
@pytest.mark.parametrize("what", OPERATORS)
def test_it_is_refused_in_words(
    addon: ModuleType, painted: bpy.types.Object, tmp_path: Path, what: str, override: bool
) -> None:
    obj = linked(addon, painted, tmp_path, override)
    assert has_learned(obj), "there must be something to show"
    before = contents(obj)
    operator, options = OPERATORS[what]
    with pytest.raises(RuntimeError, match=r"linked|overrides a linked"):
        getattr(bpy.ops.followthrough, operator)(**options)
    assert contents(obj) == before


def test_remove_leaves_a_linked_mesh_alone(addon: ModuleType, painted: bpy.types.Object, tmp_path: Path) -> None:
    obj = linked(addon, painted, tmp_path, override=False)
    before = contents(obj)
    assert bpy.ops.followthrough.remove() == {"FINISHED"}
    assert contents(obj) == before


@pytest.mark.parametrize("add_first", [False, True], ids=["added here", "added there"])
def test_what_is_set_on_an_override_is_kept(
    addon: ModuleType, character: bpy.types.Object, tmp_path: Path, add_first: bool
) -> None:
    if add_first:
        bpy.ops.followthrough.add()
    objects = link_into_new_file(addon, character, tmp_path)
    obj = objects[0].override_create(remap_local_usages=True)
    bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    path = str(tmp_path / "shot.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    obj.followthrough.output = "pc2"
    if not add_first:
        bpy.ops.followthrough.add()
    for frequency in (1.5, 1.25):  # once more after the file was opened again
        bpy.data.objects[obj.name, None].followthrough.frequency_soft = frequency
        bpy.ops.wm.save_mainfile()
        bpy.ops.wm.open_mainfile(filepath=path)
        obj = bpy.context.object
        assert obj.override_library is not None
        settings = obj.followthrough
        assert (settings.is_added, settings.output, settings.frequency_soft) == (True, "pc2", frequency)


def test_a_pin_group_of_another_file_is_refused_in_words(
    addon: ModuleType, painted: bpy.types.Object, tmp_path: Path
) -> None:
    obj = linked(addon, painted, tmp_path, override=True)
    assert len(obj.followthrough.pin_groups) == 1
    with pytest.raises(RuntimeError, match="set its strength to 0 instead"):
        bpy.ops.followthrough.remove_pin_group()
    assert len(obj.followthrough.pin_groups) == 1


def test_a_linked_object_is_left_alone(addon: ModuleType, painted: bpy.types.Object, tmp_path: Path) -> None:
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    obj, armature = link_into_new_file(addon, painted, tmp_path)
    for other in (obj, armature):
        bpy.context.scene.collection.objects.link(other)
    bpy.context.view_layer.objects.active = obj
    frequency = obj.followthrough.frequency_soft
    operators = {
        "clear": {},
        "remove": {},
        "remove_pin_group": {},
        "apply_preset": {"preset": "EARS"},
    }
    for name, arguments in operators.items():
        with pytest.raises(RuntimeError, match="Make Local"):
            getattr(bpy.ops.followthrough, name)(**arguments)
    assert not bpy.ops.followthrough.bake.poll()
    assert "or override them" in (why_not_bakeable(obj) or "")
    assert obj.followthrough.is_added
    assert len(obj.followthrough.pin_groups) == 1
    assert obj.followthrough.frequency_soft == frequency
    assert obj.data.shape_keys is not None


def test_a_bake_on_a_linked_mesh_is_not_cleared_here(
    addon: ModuleType, painted: bpy.types.Object, tmp_path: Path
) -> None:
    assert bpy.ops.followthrough.bake() == {"FINISHED"}
    obj = make_local(link_into_new_file(addon, painted, tmp_path))
    assert obj.library is None
    with pytest.raises(RuntimeError, match="clear it in that file"):
        bpy.ops.followthrough.clear()
