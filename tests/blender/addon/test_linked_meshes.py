# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be kept on a mesh of another file is refused with the reason, and nothing is changed."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import bpy
import pytest

from followthrough.blender import has_learned

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
    library, name, armature = str(folder / "library.blend"), obj.name, obj.parent.name
    bpy.data.libraries.write(library, {obj})
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    addon.unregister()
    addon.register()
    with bpy.data.libraries.load(library, link=True) as (_there, here):
        here.objects = [name, armature]
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 12
    if override:
        found = next(o for o in here.objects if o.name == name).override_create(remap_local_usages=True)
        found.data.override_create(remap_local_usages=True)
        objects = [found, *(o for o in here.objects if o.name == armature)]
    else:
        objects = list(here.objects)
    for other in objects:
        scene.collection.objects.link(other)
        other.select_set(True)
    if not override:
        bpy.ops.object.make_local(type="SELECT_OBJECT")
        objects = [bpy.data.objects[name]]
    bpy.context.view_layer.objects.active = objects[0]
    objects[0].followthrough.is_added = True
    return objects[0]


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
