# SPDX-License-Identifier: GPL-3.0-or-later
"""The add-on from its sources, and a small character: a column with two bones that bend it."""

import importlib.util
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import bpy
import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
RINGS, SIDES, HEIGHT = 13, 12, 2.0


def load_addon() -> ModuleType:
    """Import addon/ as a package, whatever its folder is called."""
    folder = ROOT / "addon"
    spec = importlib.util.spec_from_file_location(
        "followthrough_addon", folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["followthrough_addon"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def addon_module() -> ModuleType:
    return load_addon()


@pytest.fixture(autouse=True)
def addon(addon_module: ModuleType) -> Iterator[ModuleType]:
    """A fresh file with the add-on in it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon_module.register()
    yield addon_module
    addon_module.unregister()


def make_armature(name: str) -> bpy.types.Object:
    armature = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    lower = armature.data.edit_bones.new("lower")
    lower.head, lower.tail = (0.0, 0.0, 0.0), (0.0, 0.0, HEIGHT / 2)
    upper = armature.data.edit_bones.new("upper")
    upper.head, upper.tail = lower.tail, (0.0, 0.0, HEIGHT)
    upper.parent, upper.use_connect = lower, True
    bpy.ops.object.mode_set(mode="OBJECT")
    for frame, angle in ((1, 0.0), (4, 0.7), (8, -0.4), (12, 0.0)):
        bone = armature.pose.bones["upper"]
        bone.rotation_mode = "XYZ"
        bone.rotation_euler = (angle, 0.0, 0.0)
        bone.keyframe_insert("rotation_euler", frame=frame)
    return armature


def make_mesh(name: str) -> bpy.types.Object:
    angles = np.arange(SIDES) * 2.0 * math.pi / SIDES
    rings = [
        np.column_stack([0.4 * np.cos(angles), 0.4 * np.sin(angles), np.full(SIDES, z)])
        for z in np.linspace(0.0, HEIGHT, RINGS)
    ]
    faces = [
        (r * SIDES + s, r * SIDES + (s + 1) % SIDES, (r + 1) * SIDES + (s + 1) % SIDES, (r + 1) * SIDES + s)
        for r in range(RINGS - 1)
        for s in range(SIDES)
    ]
    caps = [tuple(reversed(range(SIDES))), tuple(range((RINGS - 1) * SIDES, RINGS * SIDES))]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(np.concatenate(rings).tolist(), [], [*faces, *caps])
    obj = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(obj)
    return obj


def make_character(name: str = "Column") -> bpy.types.Object:
    """A skinned, animated mesh, selected and active; the scene has 12 frames and stands on frame 3."""
    armature = make_armature(f"{name} Rig")
    obj = make_mesh(name)
    obj.parent = armature
    obj.modifiers.new("Armature", "ARMATURE").object = armature
    for bone in ("lower", "upper"):
        group = obj.vertex_groups.new(name=bone)
        for vertex in obj.data.vertices:
            share = min(max((vertex.co.z - 0.8) / 0.4, 0.0), 1.0)
            group.add([vertex.index], share if bone == "upper" else 1.0 - share, "REPLACE")
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 12
    scene.frame_set(3)
    select(obj)
    return obj


def select(*objects: bpy.types.Object) -> None:
    """Select these alone; the first becomes active."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    for obj in objects:
        obj.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]


def link_into_new_file(addon: ModuleType, obj: bpy.types.Object, folder: Path) -> list[bpy.types.Object]:
    """The object and its armature in a new file, linked from a library, in no collection yet; the names stay."""
    library, names = str(folder / "library.blend"), [obj.name, obj.parent.name]
    bpy.data.libraries.write(library, {obj})
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    addon.unregister()
    addon.register()
    with bpy.data.libraries.load(library, link=True) as (_there, here):
        here.objects = names
    return list(here.objects)


def make_local(objects: list[bpy.types.Object]) -> bpy.types.Object:
    """Put linked objects into the scene and make them, not their data, local; the first of them, active."""
    name = objects[0].name
    for obj in objects:
        bpy.context.scene.collection.objects.link(obj)
        obj.select_set(True)
    bpy.ops.object.make_local(type="SELECT_OBJECT")
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    return bpy.data.objects[name]


@pytest.fixture
def character() -> bpy.types.Object:
    return make_character()


@pytest.fixture
def painted(character: bpy.types.Object) -> bpy.types.Object:
    """A character with Followthrough added, small enough to bake in an instant."""
    assert bpy.ops.followthrough.add() == {"FINISHED"}
    character.followthrough.cells = 8
    return character
