# SPDX-License-Identifier: GPL-3.0-or-later
"""Time of a whole bake over the time of merely stepping the same frames in Blender.

    python cpp/bench/bake_time.py [--vertices 14000] [--frames 250] [--rounds 5]

The character is a column of that many vertices on a chain of bones that swings. Stepping and baking take turns, and the
medians count; the largest error of what Blender shows stands beside the time.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time

import bpy
import numpy as np

from followthrough.blender import Bake, FrameRange, ObjectSettings, clear

BONES = 20


def build_character(vertices: int, frames: int) -> bpy.types.Object:
    """A column of about so many vertices, 4 high and 1 thick, every vertex on two of 20 bones."""
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
    length, parent = 4.0 / BONES, None
    for index in range(BONES):
        bone = rig.edit_bones.new(f"Bone {index}")
        bone.head, bone.tail = (0.0, 0.0, index * length), (0.0, 0.0, (index + 1) * length)
        bone.parent, parent = parent, bone
    bpy.ops.object.mode_set(mode="OBJECT")
    groups = [mesh.vertex_groups.new(name=f"Bone {index}") for index in range(BONES)]
    for vertex, (_, _, z) in enumerate(points):
        place = min(max(z / length - 0.5, 0.0), BONES - 1.0)
        lower = min(int(place), BONES - 2)
        groups[lower].add([vertex], 1.0 - (place - lower), "REPLACE")
        groups[lower + 1].add([vertex], place - lower, "REPLACE")
    mesh.modifiers.new("Armature", "ARMATURE").object = armature
    for index, bone in enumerate(armature.pose.bones):
        bone.rotation_mode = "XYZ"
        for frame in range(1, frames + 1, 6):
            bone.rotation_euler.x = 0.05 * math.sin(0.3 * frame + 0.2 * index)
            bone.keyframe_insert("rotation_euler", frame=frame)
    return mesh


def positions(name: str) -> np.ndarray:
    """Evaluated vertices."""
    evaluated = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(len(evaluated.data.vertices) * 3, dtype=np.float32)
    evaluated.data.vertices.foreach_get("co", points)
    return points.reshape(-1, 3)


def step(frames: int) -> float:
    """Seconds to step the frames, as playing them does."""
    began = time.perf_counter()
    for frame in range(1, frames + 1):
        bpy.context.scene.frame_set(frame)
    return time.perf_counter() - began


def bake(name: str, frames: int) -> tuple[float, dict[str, float]]:
    """Seconds of a whole bake, and of its parts."""
    began = time.perf_counter()
    run = Bake(bpy.context.scene, {name: ObjectSettings()}, FrameRange(start=1, end=frames))
    prepared = time.perf_counter()
    for _ in run.run():
        pass
    simulated = time.perf_counter()
    run.finish()
    end = time.perf_counter()
    parts = {"volume": prepared - began, "frames": simulated - prepared, "keys": end - simulated}
    return end - began, parts


def main() -> None:
    """Print the medians and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--vertices", type=int, default=14000)
    parser.add_argument("--frames", type=int, default=250)
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    name = build_character(args.vertices, args.frames).name
    step(args.frames)
    stepping, baking, parts = [], [], []
    for _ in range(args.rounds):
        clear(bpy.data.objects[name])
        stepping.append(step(args.frames))
        seconds, split = bake(name, args.frames)
        baking.append(seconds)
        parts.append(split)
    ratio = statistics.median(b / s for b, s in zip(baking, stepping, strict=True))
    inside = ", ".join(f"{part} {statistics.median(split[part] for split in parts):.2f}" for part in parts[0])
    count = len(bpy.data.objects[name].data.vertices)
    print(
        f"Blender {bpy.app.version_string}, {count} vertices, {args.frames} frames: "
        f"stepping {statistics.median(stepping):.2f} s, baking {statistics.median(baking):.2f} s ({inside}), "
        f"ratio {ratio:.2f}"
    )


if __name__ == "__main__":
    main()
