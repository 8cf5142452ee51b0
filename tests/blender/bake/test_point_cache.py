# SPDX-License-Identifier: GPL-3.0-or-later
"""A point cache plays what the shape keys of the same bake play, beside the .blend and without a change to the mesh."""

from __future__ import annotations

import struct

import bpy
import numpy as np
import pytest

from followthrough.blender import (
    Bake,
    FrameRange,
    NotBakeableError,
    ObjectSettings,
    baked_range,
    clear,
    point_cache,
    why_not_bakeable,
)
from followthrough.cli import main
from followthrough.settings import Settings, SpringSettings, VolumeSettings

MOTION = Settings(
    solver="springs", volume=VolumeSettings(cells=8), springs=SpringSettings(stiffness_range=(60.0, 60.0))
)
KEYS = ObjectSettings(motion=MOTION)
CACHE = ObjectSettings(motion=MOTION, output="pc2")


@pytest.fixture(autouse=True)
def saved_file(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))


def plain(character):
    pass


def preserve_volume(character):
    character.modifier.use_deform_preserve_volume = True


def lattice_after(character):
    lattice = bpy.data.objects.new("Lattice", bpy.data.lattices.new("Lattice"))
    bpy.context.scene.collection.objects.link(lattice)
    lattice.location.z, lattice.scale = 1.0, (2.0, 2.0, 3.0)
    lattice.data.points[0].co_deform.x += 0.2
    character.mesh.modifiers.new("Lattice", "LATTICE").object = lattice
    bpy.context.view_layer.update()


def remapped_time(character):
    bpy.context.scene.render.frame_map_old, bpy.context.scene.render.frame_map_new = 100, 150


def idle_keys(character):
    character.mesh.shape_key_add(name="Basis")
    smile = character.mesh.shape_key_add(name="Smile")
    smile.points[3].co.x += 0.3
    smile.value = 0.0


@pytest.mark.parametrize("prepare", [plain, preserve_volume, lattice_after, remapped_time, idle_keys])
def test_it_plays_what_shape_keys_play(character, prepare):
    prepare(character)
    times = [0, 1, 2, 2.25, 3, 5.5, 7, 8, 9, 20]
    character.bake(KEYS, FrameRange(start=2, end=7))
    expected = [character.positions(time) for time in times]
    clear(character.mesh)
    bare = [character.positions(time) for time in times]
    character.bake(CACHE, FrameRange(start=2, end=7))
    assert baked_range(character.mesh) == (2, 7)
    assert max(np.abs(keyed - still).max() for keyed, still in zip(expected, bare, strict=True)) > 1e-3
    for time, keyed in zip(times, expected, strict=True):
        assert np.abs(character.positions(time) - keyed).max() < 2e-6 * character.size


def test_the_mesh_is_left_alone_and_the_file_is_a_pc2(character, tmp_path):
    character.bake(CACHE)
    assert character.mesh.data.shape_keys is None
    assert [modifier.type for modifier in character.mesh.modifiers] == ["MESH_CACHE", "ARMATURE"]
    content = (tmp_path / "shot_Creature.pc2").read_bytes()
    magic, version, points, start, rate, samples = struct.unpack("<12siiffi", content[:32])
    assert (magic, version, points, start, rate, samples) == (b"POINTCACHE2\0", 1, 72, 0.0, 1.0, 10)
    assert len(content) == 32 + 10 * 72 * 12
    assert character.mesh.modifiers[0].filepath == "//shot_Creature.pc2"


def test_it_plays_after_saving_and_opening(character, tmp_path):
    character.bake(CACHE)
    shown = character.positions(5)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    assert np.array_equal(character.positions(5), shown)
    assert not list(tmp_path.glob(".*"))


def test_baking_again_replaces_it_and_each_kind_the_other(character):
    character.bake(CACHE)
    first = character.positions(5)
    character.bake(CACHE)
    assert np.array_equal(character.positions(5), first)
    assert len(character.mesh.modifiers) == 2
    character.bake(KEYS)
    assert [modifier.type for modifier in character.mesh.modifiers] == ["ARMATURE"]
    assert len(character.mesh.data.shape_keys.key_blocks) == 9
    assert np.abs(character.positions(5) - first).max() < 2e-6 * character.size
    character.bake(CACHE)
    assert character.mesh.data.shape_keys is None
    assert np.array_equal(character.positions(5), first)


def test_clear_takes_the_modifier_off_and_leaves_others(character):
    own = character.mesh.modifiers.new("Mine", "SMOOTH")
    own.show_viewport = False
    before = character.positions(5)
    character.bake(CACHE)
    assert clear(character.mesh)
    assert [modifier.name for modifier in character.mesh.modifiers] == ["Armature", "Mine"]
    assert np.array_equal(character.positions(5), before)
    assert not clear(character.mesh)
    assert baked_range(character.mesh) is None


@pytest.mark.parametrize("shown", [True, False])
def test_a_cancelled_bake_leaves_the_earlier_one(character, tmp_path, shown):
    character.bake(CACHE)
    character.mesh.modifiers[0].show_viewport = shown
    content = (tmp_path / "shot_Creature.pc2").read_bytes()
    bake = Bake(bpy.context.scene, {character.mesh_name: CACHE}, FrameRange(end=4))
    run = bake.run()
    next(run)
    assert not character.mesh.modifiers[0].show_viewport
    run.close()
    assert character.mesh.modifiers[0].show_viewport == shown
    assert baked_range(character.mesh) == (1, 8)
    assert (tmp_path / "shot_Creature.pc2").read_bytes() == content


def test_a_linked_mesh_can_be_baked_and_plays_when_opened_again(character, tmp_path):
    bpy.ops.wm.save_mainfile()
    library = str(tmp_path / "shot.blend")
    shot = tmp_path / "linked.blend"
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(library, link=True) as (_, linked):
        linked.objects = ["Creature", "Creature rig"]
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 8
    for obj in linked.objects:
        scene.collection.objects.link(obj)
    bpy.ops.object.select_all(action="DESELECT")
    for obj in linked.objects:
        obj.select_set(True)
    bpy.ops.object.make_local(type="SELECT_OBJECT")
    mesh = bpy.data.objects["Creature"]
    assert mesh.library is None
    assert mesh.data.library is not None
    bpy.ops.wm.save_as_mainfile(filepath=str(shot))
    assert "Point Cache" in why_not_bakeable(mesh)
    assert why_not_bakeable(mesh, "pc2") is None
    before = character.positions(5)
    character.bake(CACHE)
    shown = character.positions(5)
    assert np.abs(shown - before).max() > 1e-3
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=str(shot))
    assert bpy.data.objects["Creature"].data.library is not None
    assert np.array_equal(character.positions(5), shown)


def test_a_library_override_keeps_its_bake(character, tmp_path):
    bpy.ops.wm.save_mainfile()
    library = bpy.data.filepath
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(library, link=True) as (_, linked):
        linked.objects = ["Creature", "Creature rig"]
    for obj in linked.objects:
        bpy.context.scene.collection.objects.link(obj)
        obj.override_create(remap_local_usages=True)
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 8
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "override.blend"))
    character.bake(CACHE)
    shown = character.positions(5)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    assert character.mesh.override_library is not None
    assert baked_range(character.mesh) == (1, 8)
    assert np.array_equal(character.positions(5), shown)
    character.bake(CACHE)
    assert [modifier.type for modifier in character.mesh.modifiers] == ["MESH_CACHE", "ARMATURE"]
    assert np.array_equal(character.positions(5), shown)


def test_meshes_that_are_shared_are_baked_each_for_itself(character):
    twin = bpy.data.objects.new("Twin", character.mesh.data)
    bpy.context.scene.collection.objects.link(twin)
    character.bake(CACHE)
    assert len(twin.modifiers) == 0
    assert "shares its mesh" in why_not_bakeable(character.mesh)


def linked_object(character):
    bpy.ops.wm.save_mainfile()
    library = bpy.data.filepath
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    with bpy.data.libraries.load(library, link=True) as (_, linked):
        linked.objects = ["Creature", "Creature rig"]
    for obj in linked.objects:
        bpy.context.scene.collection.objects.link(obj)
    return "make the object local"


def active_keys(character):
    character.mesh.shape_key_add(name="Basis")
    character.mesh.shape_key_add(name="Smile").value = 0.5
    return "shape keys that take part"


def deformed_by_parent(character):
    character.mesh.modifiers.clear()
    character.mesh.parent_type = "ARMATURE"
    return "deformed by its parent"


@pytest.mark.parametrize("spoil", [linked_object, active_keys, deformed_by_parent])
def test_what_a_point_cache_cannot_do_is_refused(character, spoil):
    reason = spoil(character)
    with pytest.raises(NotBakeableError, match=reason):
        Bake(bpy.context.scene, {character.mesh_name: CACHE})


def test_without_a_file_there_is_no_place_for_it(make_character):
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    character = make_character()
    with pytest.raises(NotBakeableError, match="save the file first"):
        Bake(bpy.context.scene, {character.mesh_name: CACHE})


def test_names_that_are_no_file_names_do_not_collide(tmp_path):
    paths = {point_cache.path_of(tmp_path / "a.blend", name) for name in ("Body", "Bo/dy", "Bo_dy", "Bo dy", "..")}
    assert len(paths) == 5
    assert {path.parent for path in paths} == {tmp_path}


@pytest.mark.parametrize("elsewhere", [False, True])
def test_the_command_writes_it_beside_its_output(character, tmp_path, capfd, elsewhere):
    bpy.ops.wm.save_mainfile()
    folder = tmp_path / "out"
    folder.mkdir()
    target = (folder if elsewhere else tmp_path) / "baked.blend"
    arguments = ["bake", bpy.data.filepath, "-o", str(target), "--cells", "8", "--quiet", "--output-kind", "pc2"]
    assert main(arguments) == 0
    assert f"{target.parent / 'baked_Creature.pc2'}: written" in capfd.readouterr().out
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert character.mesh.modifiers[0].filepath == "//baked_Creature.pc2"
    shown = character.positions(5)
    character.mesh.modifiers[0].show_viewport = False
    assert np.abs(shown - character.positions(5)).max() > 1e-3
