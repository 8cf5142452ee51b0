# SPDX-License-Identifier: GPL-3.0-or-later
"""`followthrough bake` on real files: what it writes plays, and what it cannot do it says without writing."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import bpy
import numpy as np
import pytest

from followthrough.blender import bake_recovery, baked_range, cache_folder, shape_keys
from followthrough.cli import main

QUICK = ["--cells", "8", "--quiet"]


def save(path):
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def add_action(character, name, frames, angle):
    """A second action of the armature, which does not play."""
    animation = character.armature.animation_data
    kept, kept_slot = animation.action, getattr(animation, "action_slot", None)
    animation.action = None
    bone = character.armature.pose.bones["Upper"]
    for frame, turn in ((1, 0.0), (frames, angle)):
        bone.rotation_euler.y = turn
        bone.keyframe_insert("rotation_euler", frame=frame)
    animation.action.name = name
    animation.action.use_fake_user = True
    animation.action = kept
    if kept_slot is not None:
        animation.action_slot = kept_slot


def only_mesh():
    return next(obj for obj in bpy.data.objects if obj.type == "MESH" and obj.data.shape_keys is not None)


def test_a_blend_file_is_baked_and_plays(character, tmp_path, capfd):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    before = source.read_bytes()
    assert main(["bake", str(source), "-o", str(target), *QUICK]) == 0
    out = capfd.readouterr().out
    assert "Creature: frames 1 to 8, 72 vertices" in out
    assert f"{target}: written" in out
    assert source.read_bytes() == before
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert baked_range(character.mesh) == (1, 8)
    moved = character.positions(5) - character.skinned(5)
    assert np.abs(moved).max() > 0.01
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.blend", "out.blend"]


def test_a_file_can_be_baked_onto_itself(character, tmp_path):
    source = save(tmp_path / "in.blend")
    for _ in range(2):
        assert main(["bake", str(source), "-o", str(source), *QUICK]) == 0
        assert len(bpy.data.objects[character.mesh_name].data.shape_keys.key_blocks) == 9
        assert [path.name for path in tmp_path.iterdir()] == ["in.blend"]


EXPORT = """
import os
import sys
import bpy

blend, path, start, end = sys.argv[1:]
for obj in list(bpy.data.objects):
    bpy.data.objects.remove(obj)
with bpy.data.libraries.load(blend) as (there, here):
    here.objects = there.objects
for obj in here.objects:
    bpy.context.scene.collection.objects.link(obj)
bpy.context.scene.frame_start, bpy.context.scene.frame_end = int(start), int(end)
if path.endswith(".glb"):
    bpy.ops.export_scene.gltf(filepath=path, export_animation_mode="ACTIONS")
else:
    bpy.ops.export_scene.fbx(filepath=path, add_leaf_bones=False, bake_anim_use_all_actions=True)
os._exit(0)  # without Python's shutdown, in which 4.2 crashes
"""


def export(blend, path):
    """Write a .glb or .fbx of what is saved there, in a Blender of its own.

    In 4.2 the glTF exporter can break a session that has opened many files.
    """
    scene = bpy.context.scene
    arguments = [str(blend), str(path), str(scene.frame_start), str(scene.frame_end)]
    subprocess.run([sys.executable, "-c", EXPORT, *arguments], check=True, capture_output=True)
    assert path.is_file()
    return path


@pytest.mark.parametrize("ending", ["glb", "fbx"])
def test_imported_files_are_baked_over_their_action(character, tmp_path, ending):
    source, target = export(save(tmp_path / "in.blend"), tmp_path / f"in.{ending}"), tmp_path / "out.blend"
    assert main(["bake", str(source), "-o", str(target), *QUICK]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(target))
    scene, mesh = bpy.context.scene, only_mesh()
    start, end = baked_range(mesh)
    assert (scene.frame_start, scene.frame_end) == (start, end)
    assert end - start == 7
    key = mesh.data.shape_keys
    rest = shape_keys.read_points(key.reference_key)
    assert max(np.abs(shape_keys.read_points(block) - rest).max() for block in key.key_blocks) > 0.01
    scene.frame_set(end)
    assert [block.value for block in key.key_blocks[1:]] == [0.0] * 7 + [1.0]
    assert all(image.packed_file is not None for image in bpy.data.images if image.source == "FILE")


def test_the_chosen_action_plays_alone(character, tmp_path):
    add_action(character, "Wave", frames=5, angle=1.0)
    track = character.armature.animation_data.nla_tracks.new()
    track.strips.new("Other", 1, character.armature.animation_data.action)
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    assert main(["bake", str(source), "-o", str(target), "--action", "Wave", *QUICK]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert baked_range(character.mesh) == (1, 5)
    assert character.armature.animation_data.action.name == "Wave"
    bpy.context.scene.frame_set(5)
    assert character.armature.pose.bones["Upper"].rotation_euler.y == pytest.approx(1.0)
    assert character.armature.pose.bones["Upper"].rotation_euler.x == pytest.approx(0.0)


def test_every_skinned_mesh_is_baked_unless_some_are_chosen(make_character, tmp_path, capfd):
    for name in ("One", "Two", "Hidden"):
        make_character(name)
    bpy.data.objects["Hidden"].hide_viewport = True
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("Prop", bpy.data.meshes.new("Prop")))
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    assert main(["bake", str(source), "-o", str(target), *QUICK]) == 0
    assert {obj.name for obj in bpy.data.objects if baked_range_of(obj)} == {"One", "Two"}
    assert "'Hidden'" in capfd.readouterr().err
    assert main(["bake", str(source), "--object", "Two", "-o", str(target), *QUICK]) == 0
    assert {obj.name for obj in bpy.data.objects if baked_range_of(obj)} == {"Two"}


def baked_range_of(obj):
    return baked_range(obj) if obj.type == "MESH" else None


def test_several_scenes_are_baked_each_over_its_own_frames(make_character, tmp_path):
    make_character("One")
    other = bpy.data.scenes.new("Other")
    two = make_character("Two")
    for obj in (two.mesh, two.armature):
        other.collection.objects.link(obj)
        bpy.context.scene.collection.objects.unlink(obj)
    other.frame_start, other.frame_end = 2, 5
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    assert main(["bake", str(source), "-o", str(target), *QUICK]) == 0
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert baked_range(bpy.data.objects["One"]) == (1, 8)
    assert baked_range(bpy.data.objects["Two"]) == (2, 5)
    assert np.abs(np.diff(two.offsets(), axis=0)).max() > 0.001


def test_options_reach_the_bake(character, tmp_path, capfd):
    for name in ("Belt", "Odd: name"):
        group = character.mesh.vertex_groups.new(name=name)
        group.add(range(72), 1.0, "REPLACE")
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    command = ["bake", str(source), "-o", str(target), "--start", "2", "--end", "6", *QUICK]

    def largest(*options):
        assert main([*command, *options]) == 0
        line = next(line for line in capfd.readouterr().out.splitlines() if line.startswith("Creature:"))
        assert "frames 2 to 6" in line
        return float(line.split("largest displacement ")[1].split()[0])

    soft = largest("--stiffness", "50:500", "--damping-ratio", "0.1")
    assert soft > largest("--stiffness", "5000", "--damping", "60") > 0.0
    assert largest("--preroll", "3") != largest()
    assert largest("--cycles", "2") != largest()
    assert largest("--pin-groups", "Odd: name", "Belt:0.5") == 0.0
    assert largest("--pin-groups", "Belt:0.5") > 0.0
    assert largest("--stiffness-group", "Belt", "--mass-group", "Belt", "--no-split-parts") > 0.0


def test_options_of_the_simulation_reach_the_bake(character, tmp_path, capfd):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    command = ["bake", str(source), "-o", str(target), "--solver", "implicit-euler", *QUICK]

    def largest(*options):
        assert main([*command, *options]) == 0
        line = next(line for line in capfd.readouterr().out.splitlines() if line.startswith("Creature:"))
        return float(line.split("largest displacement ")[1].split()[0])

    usual = largest()
    assert usual > largest("--youngs-modulus", "5e4:1e6") > 0.0
    assert largest("--youngs-modulus", "300") > usual
    assert largest("--density", "2000:8000") > usual
    assert largest("--damping-ratio", "2") < usual
    assert largest("--gravity", "9.81") != usual
    assert largest("--quality", "converged") == pytest.approx(usual, rel=0.1)
    assert largest("--quality", "preview") > 0.0


def fails(capfd, arguments, message):
    assert main(["bake", *map(str, arguments), *QUICK]) == 2
    gc.collect()  # what the error's frames held of the file, while it is still open
    captured = capfd.readouterr()
    lines = [line for line in captured.err.splitlines() if line.startswith("followthrough: error:")]
    assert len(lines) == 1
    assert message in lines[0]


def test_bad_files_are_refused(character, tmp_path, capfd):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    for ending in ("blend", "glb", "gltf", "fbx"):
        foreign = tmp_path / f"foreign.{ending}"
        foreign.write_bytes(b"this is something else" * 10)
        fails(capfd, [foreign, "-o", target], "cannot be read")
    cut = tmp_path / "cut.blend"
    cut.write_bytes(source.read_bytes()[: source.stat().st_size // 3])
    fails(capfd, [cut, "-o", target], "cut.blend")
    (tmp_path / "empty.blend").touch()
    fails(capfd, [tmp_path / "empty.blend", "-o", target], "cannot be read")
    (tmp_path / "in.obj").touch()
    fails(capfd, [tmp_path / "in.obj", "-o", target], "expected .blend, .glb, .gltf or .fbx")
    fails(capfd, [tmp_path / "nowhere.blend", "-o", target], "nowhere.blend")
    fails(capfd, [tmp_path, "-o", target], str(tmp_path))
    fails(capfd, [source, "-o", tmp_path / "out.glb"], "expected .blend")
    fails(capfd, [source, "-o", tmp_path / "missing" / "out.blend"], "folder is not there")
    (tmp_path / "folder.blend").mkdir()
    fails(capfd, [source, "-o", tmp_path / "folder.blend"], "is a folder")
    assert not target.exists()


def test_bad_choices_are_refused(character, tmp_path, capfd):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    fails(capfd, [source, "-o", target, "--object", "Nobody"], "'Nobody' in the file")
    fails(capfd, [source, "-o", target, "--object", "Creature rig"], "is no mesh")
    fails(capfd, [source, "-o", target, "--action", "Dance"], "expected one of Creature rigAction")
    fails(capfd, [source, "-o", target, "--start", "9"], "at least one frame")
    fails(capfd, [source, "-o", target, "--pin-groups", "No"], "no vertex group 'No'")
    fails(capfd, [source, "-o", target, "--pin-groups", "Lower:7"], "expected 0 to 1")
    fails(capfd, [source, "-o", target, "--stiffness", "5:1"], "low <= high")
    fails(capfd, [source, "-o", target, "--stiffness", "0"], "0 < low")
    fails(capfd, [source, "-o", target, "--damping", "nan"], "finite")
    fails(capfd, [source, "-o", target, "--damping", "3", "--damping-ratio", "0.3"], "expected one of them")
    fails(capfd, [source, "-o", target, "--solver", "magic"], "expected springs or emulator or implicit-euler")
    fails(
        capfd,
        [source, "-o", target, "--solver", "springs", "--youngs-modulus", "5"],
        "only with emulator or implicit-euler",
    )
    flesh = [source, "-o", target, "--solver", "implicit-euler"]
    fails(capfd, [*flesh, "--stiffness", "5"], "expected only with springs")
    fails(capfd, [*flesh, "--youngs-modulus", "5:1"], "youngs_modulus_range: found 5 to 1")
    fails(capfd, [*flesh, "--density", "0"], "0 < low")
    fails(capfd, [*flesh, "--gravity", "inf"], "finite")
    assert not target.exists()


def test_files_without_anything_to_bake_are_refused(character, tmp_path, capfd):
    target = tmp_path / "out.blend"
    character.mesh.modifiers.clear()
    character.mesh.parent = None
    fails(capfd, [save(tmp_path / "unskinned.blend"), "-o", target], "moved by no armature")
    bpy.data.objects.remove(character.mesh)
    fails(capfd, [save(tmp_path / "no-mesh.blend"), "-o", target], "has no mesh")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    fails(capfd, [export(save(tmp_path / "empty.blend"), tmp_path / "empty.glb"), "-o", target], "")
    assert not target.exists()


def test_a_folder_that_cannot_be_written_is_refused(character, tmp_path, capfd):
    source = save(tmp_path / "in.blend")
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    if Path("/proc/self").is_dir():  # on Linux: the administrator may write everywhere else
        closed = Path("/proc/self")
    fails(capfd, [source, "-o", closed / "out.blend"], closed.name)


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_interrupted_it_leaves_nothing_behind(character, tmp_path, monkeypatch, capfd):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    target.write_bytes(b"as it was")
    timer = threading.Timer(1.0, os.kill, (os.getpid(), signal.SIGINT))
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        timer.start()
        status = main(["bake", str(source), "-o", str(target), "--start", "1", "--end", "200000", *QUICK])
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, previous)
    assert status == 130
    assert target.read_bytes() == b"as it was"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.blend", "out.blend"]


def test_killed_the_same_command_goes_on(character, tmp_path, capfd, monkeypatch):
    monkeypatch.undo()  # the same paint as in the other process
    source, target, whole = save(tmp_path / "in.blend"), tmp_path / "out.blend", tmp_path / "whole.blend"
    options = ["--start", "1", "--end", "400", "--solver", "implicit-euler", *QUICK]
    program = tmp_path / "program.py"  # stands still after the twentieth time that it has saved
    program.write_text(
        "import itertools, sys, time\n"
        "from followthrough.blender import bake_cache, bake_recovery\n"
        "from followthrough.cli import main\n"
        "bake_recovery.SAVE_INTERVAL, save, count = 0.0, bake_cache.BakeCache.save, itertools.count(1)\n"
        "def save_and_wait(*arguments):\n"
        "    save(*arguments)\n"
        "    if next(count) == 20:\n"
        "        print('saved', flush=True)\n"
        "        time.sleep(3600)\n"
        "bake_cache.BakeCache.save = save_and_wait\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    arguments = [sys.executable, str(program), "bake", str(source), "-o", str(target), *options]
    folder = cache_folder(target)
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as process:
        assert any("saved" in line for line in process.stdout)
        process.kill()
    assert not target.exists()
    assert folder.is_dir()
    assert main(["bake", str(source), "-o", str(target), *options]) == 0
    assert "went on from frame" in capfd.readouterr().err
    assert not folder.exists()
    resumed = character.offsets()
    assert main(["bake", str(source), "-o", str(whole), *options]) == 0
    assert "went on" not in capfd.readouterr().err
    assert character.offsets().tobytes() == resumed.tobytes()


def test_a_bake_can_be_made_to_begin_anew(character, tmp_path, capfd, monkeypatch):
    source, target = save(tmp_path / "in.blend"), tmp_path / "out.blend"
    monkeypatch.setattr(bake_recovery, "SAVE_INTERVAL", 0.0)

    def interrupted(_steps, *_args, **_options):
        for index, step in enumerate(_steps):
            if index == 4:
                raise KeyboardInterrupt
            yield step

    with monkeypatch.context() as patch:
        patch.setattr("followthrough.cli.bake.with_progress", interrupted)
        assert main(["bake", str(source), "-o", str(target), *QUICK]) == 130
    assert "the same command goes on from frame 5" in capfd.readouterr().err
    assert main(["bake", str(source), "-o", str(target), "--no-resume", *QUICK]) == 0
    assert "went on" not in capfd.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["in.blend", "out.blend"]


def test_without_blender_it_says_how_to_get_it(tmp_path):
    program = "import sys; sys.modules['bpy'] = None; from followthrough.cli import main; sys.exit(main(sys.argv[1:]))"
    arguments = ["bake", "in.blend", "-o", str(tmp_path / "out.blend")]
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "pip install 'followthrough[blender]'" in done.stderr
    assert "blender --background" in done.stderr


def hidden(character):
    character.mesh.hide_set(True)
    return "hidden"


def in_an_instanced_collection(character):
    collection = bpy.data.collections.new("Library")
    for obj in (character.mesh, character.armature):
        bpy.context.scene.collection.objects.unlink(obj)
        collection.objects.link(obj)
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", collection
    bpy.context.scene.collection.objects.link(instance)
    return "'Creature' is in no scene"


@pytest.mark.parametrize("spoil", [hidden, in_an_instanced_collection])
def test_what_is_not_shown_is_told(character, tmp_path, capfd, spoil):
    reason = spoil(character)
    target = tmp_path / "out.blend"
    assert main(["bake", str(save(tmp_path / "in.blend")), "-o", str(target), *QUICK]) == 2
    assert reason in capfd.readouterr().err
    assert not target.exists()
