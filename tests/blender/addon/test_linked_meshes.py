# SPDX-License-Identifier: GPL-3.0-or-later
"""What cannot be kept on a mesh of another file is refused with the reason, and nothing is changed."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import bpy
import pytest

from followthrough.blender import has_learned

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
