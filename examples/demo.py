# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: builds a creature, paints it, bakes its secondary motion to shape keys, and draws what that does.

    python examples/demo.py --output demo-output

writes creature.blend, contact-sheet.png and side-by-side.mp4. It needs the demo extra (`pip install .[demo]`) and no
graphics card.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

import demo_pictures
from demo_pictures import Camera, Scenery

CAMERA = Camera(position=(4.0, -5.4, 1.9), target=(0.0, 0.08, 1.0), half_height=1.27, width=360, height=432)
SHEET_CAMERA = Camera(position=(4.0, -5.4, 1.9), target=(0.0, 0.08, 1.0), half_height=1.27, width=270, height=340)

#: Moments of the contact sheet: frame and caption.
MOMENTS = [
    (23, "step"),
    (45, "crouch"),
    (54, "take-off"),
    (60, "in the air"),
    (65, "landing"),
    (69, "rebound"),
    (73, "fast stop"),
    (97, "shake"),
]


def main() -> int:
    """Run the demo."""
    parser = argparse.ArgumentParser(description="Build, paint and bake a creature, and draw its secondary motion.")
    parser.add_argument("--output", type=Path, default=Path("demo-output"), help="folder for the results")
    parser.add_argument("--vertices", type=int, default=9000, help="about how many the creature gets (default 9000)")
    arguments = parser.parse_args()
    started = time.perf_counter()
    try:
        arguments.output.mkdir(parents=True, exist_ok=True)
        blend, skinned, dynamic, scenery, fps = bake_creature(arguments.output, arguments.vertices)
    except (ValueError, OSError) as error:
        print(f"demo: error: {error}", file=sys.stderr)
        return 2
    sheet, video = draw(arguments.output, skinned, dynamic, scenery, fps)
    print(f"\nDone in {time.perf_counter() - started:.0f} s:")
    print(f"  {blend}  open it in Blender and press play; the motion is in its shape keys, no add-on needed")
    print(f"  {sheet}  skinned above, with secondary motion below")
    print(f"  {video}  the same, side by side")
    return 0


def bake_creature(folder: Path, vertices: int) -> tuple[Path, np.ndarray, np.ndarray, Scenery, float]:
    """Build and bake the creature and save it.

    Returns
    -------
    The .blend file; the vertices of every frame (f, v, 3) without and with secondary motion; what is needed to draw
    them; and frames a second.
    """
    import bpy  # here, so that the processes that only draw do not load Blender

    import demo_character
    from followthrough import blender

    with _stage("Building the creature"):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        character = demo_character.build(vertices)
        demo_character.show(character)
    scene = bpy.context.scene
    frames = range(scene.frame_start, scene.frame_end + 1)
    skinned = _record(frames, character.mesh)

    bake = blender.Bake(scene, {character.mesh.name: blender.ObjectSettings(motion=demo_character.MOTION)})
    for _ in tqdm(bake.run(), total=bake.total, desc="Baking", unit="frame"):
        pass
    report = bake.finish()
    dynamic = _record(frames, character.mesh)

    blend = folder.resolve() / "creature.blend"
    baked = report.objects[0]
    with _stage(f"Saving ({baked.vertices:,} vertices, {baked.tets:,} tets, baked in {report.seconds:.1f} s)"):
        bpy.context.preferences.filepaths.save_version = 0
        scene.frame_set(scene.frame_start)
        bpy.ops.wm.save_as_mainfile(filepath=str(blend), compress=True, check_existing=False)
    creature = character.creature
    scenery = Scenery(
        triangles=np.array([(f[0], f[k], f[k + 1]) for f in creature.faces for k in range(1, len(f) - 1)]),
        colours=creature.colours,
        occlusion=creature.occlusion,
    )
    return blend, skinned, dynamic, scenery, scene.render.fps / scene.render.fps_base


def draw(folder: Path, skinned: np.ndarray, dynamic: np.ndarray, scenery: Scenery, fps: float) -> tuple[Path, Path]:
    """Write the contact sheet and the video."""
    sheet, video = folder.resolve() / "contact-sheet.png", folder.resolve() / "side-by-side.mp4"
    jobs = [(positions[frame - 1], SHEET_CAMERA, 3) for positions in (skinned, dynamic) for frame, _ in MOMENTS]
    jobs += [(positions[frame], CAMERA, 2) for frame in range(len(skinned)) for positions in (skinned, dynamic)]
    workers = max(1, min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, 8))
    with tempfile.TemporaryDirectory() as scratch:
        demo_pictures.save_scenery(Path(scratch) / "scenery.npz", scenery)
        with ProcessPoolExecutor(
            workers,
            mp_context=get_context("spawn"),
            initializer=demo_pictures.load_scenery,
            initargs=(Path(scratch) / "scenery.npz",),
        ) as pool:
            drawn = pool.map(demo_pictures.draw_job, jobs, chunksize=4)
            pictures = list(tqdm(drawn, total=len(jobs), desc="Drawing", unit="picture"))
    count = len(MOMENTS)
    rows = [("skinned", pictures[:count]), ("with Followthrough", pictures[count : 2 * count])]
    demo_pictures.contact_sheet(rows, [caption for _, caption in MOMENTS], sheet)
    rest = pictures[2 * count :]
    frames = [
        np.hstack([demo_pictures.labelled(left, "skinned"), demo_pictures.labelled(right, "with Followthrough")])
        for left, right in zip(rest[::2], rest[1::2], strict=True)
    ]
    with _stage("Writing the video"):
        demo_pictures.write_video(frames, fps, video)
    return sheet, video


def _record(frames: range, obj: object) -> np.ndarray:
    """Vertices of an object in every frame: (f, v, 3) float32, in the world."""
    import bpy

    import demo_character

    recorded = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        recorded.append(demo_character.evaluated_positions(obj).astype(np.float32))
    return np.array(recorded)


@contextlib.contextmanager
def _stage(name: str) -> Iterator[None]:
    started = time.perf_counter()
    print(f"{name} ... ", end="", flush=True)
    with Path(os.devnull).open("w") as quiet, contextlib.redirect_stdout(quiet):
        yield
    print(f"{time.perf_counter() - started:.1f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
