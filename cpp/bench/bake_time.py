# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a whole bake over the time of merely stepping the same frames in Blender.

    python cpp/bench/bake_time.py [--vertices 14000] [--frames 250] [--rounds 5]

The character is a column of that many vertices, painted with what Add Followthrough suggests, on a bare chain of bones and on a rig
with constraints, inverse kinematics and drivers. Stepping and baking take turns, and the medians count. The first look is what Blender
then takes to evaluate all the new keys, whoever asks for it first: a redraw, or the next frame. On a busy machine look at the
processor time: what two threads do at once is added up there.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
import numpy as np

from followthrough.blender import Bake, FrameRange, ObjectSettings, add_groups, clear
from followthrough.settings import Settings


def build_column(vertices: int, frames: int) -> bpy.types.Object:
    """A column of about so many vertices, 4 high and 1 thick, on a chain of 20 bones that swings: as little rig as can be."""
    mesh, armature = build_skin(vertices, bones=20)
    for index, bone in enumerate(armature.pose.bones):
        bone.rotation_mode = "XYZ"
        for frame in range(1, frames + 1, 6):
            bone.rotation_euler.x = 0.05 * math.sin(0.3 * frame + 0.2 * index)
            bone.keyframe_insert("rotation_euler", frame=frame)
    return mesh


def build_rigged_column(vertices: int, frames: int) -> bpy.types.Object:
    """The same column as a rigger would move it, on 60 bones.

    A chain of 20 bones deforms it and copies a control chain by constraints; the control chain bends to an animated target by
    inverse kinematics; 20 helper bones beside it are turned by drivers, and deform it, too.
    """
    mesh, armature = build_skin(vertices, bones=20, controls=20, helpers=20)
    scene = bpy.context.scene
    target = bpy.data.objects.new("Target", None)
    scene.collection.objects.link(target)
    for frame in range(1, frames + 1, 6):
        target.location = (
            1.2 * math.sin(0.2 * frame),
            0.8 * math.cos(0.13 * frame),
            3.6 + 0.2 * math.sin(0.31 * frame),
        )
        target.keyframe_insert("location", frame=frame)
        armature.rotation_euler.z = 0.3 * math.sin(0.1 * frame)
        armature.keyframe_insert("rotation_euler", frame=frame)
    bones = armature.pose.bones
    reach = bones["Control 19"].constraints.new("IK")
    reach.target, reach.chain_count, reach.iterations = target, 6, 20
    for index in range(20):
        bones[f"Bone {index}"].constraints.new("COPY_TRANSFORMS").target = armature
        bones[f"Bone {index}"].constraints[0].subtarget = f"Control {index}"
        driver = bones[f"Helper {index}"].driver_add("location", 0).driver
        driver.type = "SUM"
        variable = driver.variables.new()
        variable.type = "TRANSFORMS"
        variable.targets[0].id, variable.targets[0].bone_target = armature, f"Control {index}"
        variable.targets[0].transform_type, variable.targets[0].transform_space = "ROT_X", "LOCAL_SPACE"
    return mesh


def build_skin(
    vertices: int, bones: int, controls: int = 0, helpers: int = 0
) -> tuple[bpy.types.Object, bpy.types.Object]:
    """A column of about so many vertices, every one on two bones of a chain, and its armature.

    Control bones lie along the chain; helpers hang on the bone beside them and hold a tenth of its skin.
    """
    segments = max(8, round(math.sqrt(vertices * math.pi / 4.0)))
    rings = max(2, vertices // segments)
    angles = np.linspace(0.0, 2.0 * math.pi, segments, endpoint=False)
    heights = np.linspace(0.0, 4.0, rings)
    points = np.array([(0.5 * math.cos(a), 0.5 * math.sin(a), z) for z in heights for a in angles])
    faces = [
        (
            r * segments + s,
            r * segments + (s + 1) % segments,
            (r + 1) * segments + (s + 1) % segments,
            (r + 1) * segments + s,
        )
        for r in range(rings - 1)
        for s in range(segments)
    ]
    data = bpy.data.meshes.new("Column")
    data.from_pydata(points.tolist(), [], faces)
    mesh = bpy.data.objects.new("Column", data)
    rig = bpy.data.armatures.new("Chain")
    armature = bpy.data.objects.new("Chain", rig)
    for obj in (mesh, armature):
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    length = 4.0 / bones

    def add(name: str, index: int, parent: str | None, deforms: bool) -> None:
        bone = rig.edit_bones.new(name)
        bone.head, bone.tail = (0.0, 0.0, index * length), (0.0, 0.0, (index + 1) * length)
        bone.parent, bone.use_deform = rig.edit_bones.get(parent or ""), deforms

    for index in range(controls):
        add(f"Control {index}", index, f"Control {index - 1}", deforms=False)
    for index in range(bones):
        add(f"Bone {index}", index, None if controls else f"Bone {index - 1}", deforms=True)
    for index in range(helpers):
        add(f"Helper {index}", index, f"Bone {index}", deforms=True)
    bpy.ops.object.mode_set(mode="OBJECT")
    groups = [mesh.vertex_groups.new(name=f"Bone {index}") for index in range(bones)]
    beside = [mesh.vertex_groups.new(name=f"Helper {index}") for index in range(helpers)]
    for vertex, (_, _, z) in enumerate(points):
        place = min(max(z / length - 0.5, 0.0), bones - 1.0)
        lower = min(int(place), bones - 2)
        groups[lower].add([vertex], 1.0 - (place - lower), "REPLACE")
        groups[lower + 1].add([vertex], place - lower, "REPLACE")
        if beside:
            beside[lower].add([vertex], 0.1, "REPLACE")
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    add_groups(mesh)
    return mesh, armature


CHARACTERS = {"20 bones, keyed": build_column, "60 bones, constraints, IK and drivers": build_rigged_column}


@dataclass
class Seconds:
    """How long something took: as the clock has it, and of processor time of all threads."""

    wall: float
    processor: float


@contextmanager
def timed(parts: dict[str, Seconds], name: str) -> Iterator[None]:
    """Put what is inside under that name."""
    wall, processor = time.perf_counter(), time.process_time()
    yield
    parts[name] = Seconds(time.perf_counter() - wall, time.process_time() - processor)


def step(frames: int) -> None:
    """Step the frames, as playing them does."""
    for frame in range(1, frames + 1):
        bpy.context.scene.frame_set(frame)


def bake(name: str, frames: int, parts: dict[str, Seconds]) -> None:
    """A whole bake, and how long its parts took."""
    with timed(parts, "volume"):
        run = Bake(
            bpy.context.scene,
            {name: ObjectSettings(motion=Settings(solver="springs"))},
            FrameRange(start=1, end=frames),
        )
    with timed(parts, "frames"):
        for _ in run.run():
            pass
    with timed(parts, "keys"):
        run.finish()


def median(rounds: Sequence[dict[str, Seconds]], part: str) -> str:
    """Wall seconds, and those of the processor."""
    wall = statistics.median(parts[part].wall for parts in rounds)
    return f"{wall:.3f} ({statistics.median(parts[part].processor for parts in rounds):.3f})"


def measure(label: str, vertices: int, frames: int, rounds: int) -> None:
    """Step and bake one character in turns, and print the medians and their ratio."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    name = CHARACTERS[label](vertices, frames).name
    step(frames)
    done: list[dict[str, Seconds]] = []
    for _ in range(rounds):
        clear(bpy.data.objects[name])
        parts: dict[str, Seconds] = {}
        with timed(parts, "stepping"):
            step(frames)
        with timed(parts, "bake"):
            bake(name, frames, parts)
        with timed(parts, "first look"):
            bpy.context.view_layer.update()
        done.append(parts)
    ratio = statistics.median(parts["bake"].wall / parts["stepping"].wall for parts in done)
    looked = statistics.median(
        (parts["bake"].wall + parts["first look"].wall) / parts["stepping"].wall for parts in done
    )
    work = statistics.median(parts["bake"].processor / parts["stepping"].processor for parts in done)
    count = len(bpy.data.objects[name].data.vertices)
    print(f"{label}: {count} vertices, {frames} frames, seconds on the clock (of processor time)")
    print(
        "  "
        + ", ".join(
            f"{part} {median(done, part)}" for part in ("stepping", "bake", "volume", "frames", "keys", "first look")
        )
    )
    print(
        f"  bake over stepping: {ratio:.2f} on the clock, {work:.2f} of processor time, {looked:.2f} with the first look"
    )


def main() -> None:
    """Measure every character."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vertices", type=int, default=14000)
    parser.add_argument("--frames", type=int, default=250)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    print(f"Blender {bpy.app.version_string}")
    for label in CHARACTERS:
        measure(label, args.vertices, args.frames, args.rounds)


if __name__ == "__main__":
    main()
