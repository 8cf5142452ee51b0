# SPDX-License-Identifier: GPL-3.0-or-later
"""What a frame of the live preview takes beside what Blender itself does: `python cpp/bench/preview_time.py`.

The demo creature with about 14,000 vertices walks, jumps and shakes itself. Frames without and with the preview take turns, round by round;
medians of the rounds, milliseconds a frame.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

import demo_character
from followthrough import blender
from followthrough.settings import SOLVERS, Settings, VolumeSettings


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description="Time a frame of the live preview.")
    parser.add_argument("--vertices", type=int, default=14000)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--cells", type=int, nargs="+", default=[20, 25], help="along the longest side")
    arguments = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    character = demo_character.build(arguments.vertices)
    demo_character.show(character)
    scene, mesh = bpy.context.scene, character.mesh
    print(f"{len(mesh.data.vertices):,} vertices, {scene.frame_end} frames, Blender {bpy.app.version_string}")
    print("| solver | vertices of the volume | Blender alone | with the preview | the preview itself |")
    print("| --- | ---: | ---: | ---: | ---: |")
    for solver, cells in itertools.product(SOLVERS, arguments.cells):
        motion = replace(Settings(), solver=solver, volume=VolumeSettings(cells=cells))
        settings = blender.ObjectSettings(motion=motion)
        alone, previewed, own = [], [], []
        for _ in range(arguments.rounds):
            alone.append(_play(scene, None)[0])
            preview = blender.Preview(scene, {mesh.name: settings})
            try:
                scene.frame_set(scene.frame_start)
                preview.show(scene)
                seconds, shown = _play(scene, preview)
                previewed.append(seconds)
                own.append(shown)
                count = preview.volume_vertex_counts[mesh.name]
            finally:
                preview.end()
        row = [statistics.median(times) for times in (alone, previewed, own)]
        print(f"| {solver} | {count:,} | " + " | ".join(f"{1e3 * value:.1f}" for value in row) + " |")


def _play(scene: bpy.types.Scene, preview: blender.Preview | None) -> tuple[float, float]:
    """Seconds a frame, and those of them in the preview's own code; Blender evaluates what it is shown, as it does while playing."""
    own = 0.0

    def follow(played: bpy.types.Scene, *_: object) -> None:
        nonlocal own
        if preview is not None:
            began = time.perf_counter()
            preview.show(played)
            own += time.perf_counter() - began

    bpy.app.handlers.frame_change_post.append(follow)
    try:
        frames = range(scene.frame_start + 1, scene.frame_end + 1)
        began = time.perf_counter()
        for frame in frames:
            scene.frame_set(frame)
        return (time.perf_counter() - began) / len(frames), own / len(frames)
    finally:
        bpy.app.handlers.frame_change_post.remove(follow)


if __name__ == "__main__":
    main()
