# SPDX-License-Identifier: GPL-3.0-or-later
"""Checks a baked file against an independent simulation, frame by frame; to be run by hand.

    python tests/blender/bake/verify_bake.py IN OUT.blend [--action NAME] [--solver NAME] [--quality NAME]

IN is baked again here step by step, without shape keys; every frame of OUT must equal its own skinning plus those
displacements. IN must have been baked with the default settings but those. Springs are stepped by `SecondaryMotion`; for the
simulation body, pins and solver are put together here, from the bare arrays.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy
import numpy as np

from followthrough import blender
from followthrough.blender import actions, files
from followthrough.blender.rig_reading import make_reader
from followthrough.blender.scene import require_bakeable, skeleton_of
from followthrough.elastic import QUALITIES, ElasticBody, ImplicitEuler
from followthrough.secondary_motion import RiggedMotion, SecondaryMotion
from followthrough.settings import SOLVERS, Settings
from followthrough.volume import build_volume

TOLERANCE = 1e-4


def spring_displacements(surface, paint, poses, dt: float) -> list[np.ndarray]:
    motion = SecondaryMotion(surface, paint, Settings(solver="springs"), dt)
    results = [motion.reset(poses[0])]
    for index in range(1, len(poses)):
        results.append(motion.step(poses[index], poses[index + 1] if index + 1 < len(poses) else None))
    return [result.displacements for result in results]


def simulated_displacements(surface, paint, poses, dt: float, quality: str) -> list[np.ndarray]:
    volume = build_volume(surface, paint)
    size = np.ptp(volume.surface.rest_positions @ surface.object_scale.T, axis=0).max()
    # Joints may stick out of the mesh.
    assert size <= surface.size < 1.2 * size
    size = surface.size
    modulus = 2e3 ** (1.0 - volume.stiffness) * 1e5**volume.stiffness
    density = 250.0 ** (1.0 - volume.mass) * 4e3**volume.mass
    body = ElasticBody(volume.tet_mesh.vertices, volume.tet_mesh.tets, modulus * size**2, density=density)
    hard = volume.pins >= 1 - 1e-4
    soft = np.where(hard, 0.0, volume.pins)
    solver = ImplicitEuler(
        body,
        hard,
        dt,
        quality=quality,
        pin_stiffness=body.lumped_mass
        * (0.5 * np.pi * np.sqrt(modulus / 2.9 / density) / 0.1) ** 2
        * soft
        / (1.0 - soft),
    )
    # To the last bit those of the bake: where a step does not converge, round-off decides where it stops.
    posing = RiggedMotion(volume, solver, Settings().minimum_stretch)
    references = [posing.reference(pose) for pose in poses]
    solver.reset(references[0])
    moved = [references[0], *(solver.step(reference) for reference in references[1:])]
    return [volume.surface_displacements(*pair) for pair in zip(moved, references, strict=True)]


def simulate(args: argparse.Namespace) -> tuple[str, int, float, list[np.ndarray], np.ndarray]:
    imported = files.open_file(args.input)
    action = args.action
    scene = bpy.context.scene
    obj = blender.skinned_meshes(scene)[0]
    armature = skeleton_of(obj)
    span = (scene.frame_start, scene.frame_end)
    if action is not None:
        span = actions.play_action([armature], action)
    elif imported:
        span = actions.played_range([armature]) or span
    scene.frame_set(span[0])
    surface = blender.read_surface(obj)
    paint = blender.read_paint(obj, surface)
    dt = scene.render.fps_base / scene.render.fps
    reader = make_reader(obj, require_bakeable(obj), surface)
    poses = []
    for frame in range(span[0], span[1] + 1):
        scene.frame_set(frame)
        poses.append(reader.read(bpy.context.view_layer))
    if args.solver == "springs":
        displacements = spring_displacements(surface, paint, poses, dt)
    else:
        displacements = simulated_displacements(surface, paint, poses, dt, args.quality)
    return obj.name, span[0], float(np.ptp(surface.rest_positions)), displacements, paint.pins


def positions(name: str, frame: float) -> np.ndarray:
    bpy.context.scene.frame_set(int(np.floor(frame)), subframe=frame - np.floor(frame))
    evaluated = bpy.data.objects[name].evaluated_get(bpy.context.evaluated_depsgraph_get())
    points = np.empty(len(evaluated.data.vertices) * 3, dtype=np.float32)
    evaluated.data.vertices.foreach_get("co", points)
    matrix = np.array(evaluated.matrix_world)
    return points.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("input", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--action")
    parser.add_argument("--solver", choices=SOLVERS, default=Settings().solver)
    parser.add_argument("--quality", choices=QUALITIES, default=Settings().simulation.quality)
    args = parser.parse_args()
    name, start, size, displacements, pins = simulate(args)
    bpy.ops.wm.open_mainfile(filepath=str(args.output))
    blocks = [b for b in bpy.data.objects[name].data.shape_keys.key_blocks if b.name.startswith("Followthrough")]
    played = [positions(name, start + index) for index in range(len(displacements))]
    outside = [positions(name, frame) for frame in (start - 1, start + len(displacements))]
    for block in blocks:
        block.mute = True
    skinned = [positions(name, start + index) for index in range(len(displacements))]
    error = max(np.abs(p - s - d).max() for p, s, d in zip(played, skinned, displacements, strict=True)) / size
    pinned = pins >= 1 - 1e-4
    slip = max((np.abs(p - s)[pinned].max(initial=0.0) for p, s in zip(played, skinned, strict=True))) / size
    still = max(
        np.abs(p - positions(name, f)).max()
        for p, f in zip(outside, (start - 1, start + len(displacements)), strict=True)
    )
    largest = max(np.linalg.norm(d, axis=1).max() for d in displacements)
    rest = bpy.data.objects[name].data
    coordinates = np.empty(len(rest.vertices) * 3, dtype=np.float32)
    rest.vertices.foreach_get("co", coordinates)
    _, first, inverse = np.unique(coordinates.reshape(-1, 3), axis=0, return_index=True, return_inverse=True)
    twins = first[inverse.ravel()]
    seams = max(np.abs(p - p[twins]).max() - np.abs(s - s[twins]).max() for p, s in zip(played, skinned, strict=True))
    print(
        f"{bpy.app.version_string}: {args.output.name}: {len(displacements)} frames, size {size:.4g}, "
        f"largest displacement {largest:.4g}, error {error:.1e}, pins {int(pinned.sum())} slip {slip:.1e}, "
        f"outside {still / size:.1e}, seams opened by {seams / size:.1e}"
    )
    return int(not (error < TOLERANCE and slip < 1e-6 and still == 0.0 and seams / size < 1e-6))


if __name__ == "__main__":
    sys.exit(main())
