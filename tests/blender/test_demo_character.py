# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's creature: sound as a mesh and a rig, and soft where it was painted soft."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections import Counter
from pathlib import Path

import bpy
import numpy as np
import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
sys.path.insert(0, str(EXAMPLES))

import demo_character  # noqa: E402
import demo_creature  # noqa: E402
import demo_motion  # noqa: E402
from followthrough import blender  # noqa: E402

SMALL = 2500


def weights_of(obj: bpy.types.Object, names: list[str]) -> np.ndarray:
    columns = {obj.vertex_groups[name].index: column for column, name in enumerate(names)}
    weights = np.zeros((len(obj.data.vertices), len(names)))
    for vertex in obj.data.vertices:
        for element in vertex.groups:
            if element.group in columns:
                weights[vertex.index, columns[element.group]] = element.weight
    return weights


def positions_in(frames: range, obj: bpy.types.Object) -> np.ndarray:
    recorded = []
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        recorded.append(demo_character.evaluated_positions(obj))
    return np.array(recorded)


@pytest.mark.parametrize("vertices", [2000, 3300, 6000])
def test_every_part_is_closed_and_looks_outwards(vertices: int) -> None:
    creature = demo_creature.make_creature(vertices)
    assert len(creature.vertices) == pytest.approx(vertices, rel=0.1)
    sides = Counter((face[k - 1], face[k]) for face in creature.faces for k in range(len(face)))
    assert set(sides.values()) == {1}
    assert all((b, a) in sides for a, b in sides)
    body = [face for face in creature.faces if face[0] < creature.body]
    assert all(len(face) == 4 for face in body)
    for faces in (body, [face for face in creature.faces if face[0] >= creature.body]):
        triangles = np.array([(f[0], f[k], f[k + 1]) for f in faces for k in range(1, len(f) - 1)])
        a, b, c = (creature.vertices[triangles[:, k]] for k in range(3))
        assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


def test_body_is_one_symmetric_piece_on_the_floor() -> None:
    creature = demo_creature.make_creature(SMALL)
    piece = np.arange(creature.body)
    edges = np.array([(f[k - 1], f[k]) for f in creature.faces if f[0] < creature.body for k in range(4)])
    for _ in range(400):
        lowest = piece.copy()
        np.minimum.at(lowest, edges[:, 0], piece[edges[:, 1]])
        np.minimum.at(lowest, edges[:, 1], piece[edges[:, 0]])
        if np.array_equal(lowest, piece):
            break
        piece = lowest
    assert (piece == 0).all()
    body = creature.vertices[: creature.body]
    mirrored = body * [-1.0, 1.0, 1.0]
    nearest = np.sqrt(((mirrored[:, None] - body[None]) ** 2).sum(axis=2).min(axis=1))
    assert nearest.max() < 1e-6
    assert 0.0 <= body[:, 2].min() < 0.02


def test_the_same_number_gives_the_same_creature() -> None:
    first, second = (demo_creature.make_creature(SMALL) for _ in range(2))
    for name in ("vertices", "colours", "weights", "stiffness", "mass", "pins"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()
    assert first.faces == second.faces


def test_too_few_vertices_are_refused() -> None:
    with pytest.raises(ValueError, match="vertices: found 100"):
        demo_creature.make_creature(100)


def test_every_vertex_hangs_on_bones_and_is_painted() -> None:
    character = demo_character.build(SMALL)
    bones = [bone.name for bone in character.armature.data.bones]
    assert sorted(bones) == sorted(character.creature.bones)
    weights = weights_of(character.mesh, bones)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-5)
    assert (weights > 0).sum(axis=1).max() <= 4
    painted = weights_of(character.mesh, [blender.STIFFNESS_GROUP, blender.MASS_GROUP, blender.PINS_GROUP])
    creature = character.creature
    np.testing.assert_allclose(painted, np.column_stack([creature.stiffness, creature.mass, creature.pins]), atol=1e-6)
    assert blender.why_not_bakeable(character.mesh) is None


def test_actions_are_there_and_move_the_armature() -> None:
    character = demo_character.build(SMALL, painted=False)
    for name in ("Walk", "Jump", "Shake"):
        assert bpy.data.actions[name].frame_range[1] == demo_motion.ACTIONS[name][1]
    demo_character.show(character)
    scene = bpy.context.scene
    assert (scene.frame_start, scene.render.fps) == (1, 24)
    toes = [
        v
        for v, bone in enumerate(np.argmax(character.creature.weights, axis=1))
        if "foot" in character.creature.bones[bone]
    ]
    positions = positions_in(range(1, scene.frame_end + 1), character.mesh)
    lowest = positions[:, toes, 2].min(axis=1)
    assert lowest.max() > 0.2, "it never leaves the floor"
    assert lowest.min() > -0.06, "its feet sink into the floor"
    assert np.abs(np.diff(positions, axis=0)).max() < 0.5, "it jerks from one action to the next"


def test_walk_closes() -> None:
    first, last = demo_motion.walk(0.0), demo_motion.walk(24.0)
    assert first.hips == pytest.approx(last.hips)
    for bone, turn in first.turns.items():
        assert turn == pytest.approx(last.turns[bone])
    for side in "LR":
        assert first.ankles[side] == pytest.approx(last.ankles[side])


def test_belly_ears_and_tail_move_after_a_bake_and_pins_do_not() -> None:
    character = demo_character.build(SMALL)
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = demo_motion.FPS, 1.0
    scene.frame_start, scene.frame_end = 1, demo_motion.play(character.armature, [("Jump", 1, 1, 0)])
    frames = range(1, scene.frame_end + 1)
    skinned = positions_in(frames, character.mesh)
    bake = blender.Bake(
        scene,
        {
            character.mesh.name: blender.ObjectSettings(
                motion=dataclasses.replace(demo_character.MOTION, solver="implicit-euler")
            )
        },
    )
    for _ in bake.run():
        pass
    bake.finish()
    moved = np.linalg.norm(positions_in(frames, character.mesh) - skinned, axis=2)

    creature = character.creature
    regions = demo_creature.body_regions(creature.vertices[: creature.body])
    for region, least in (("belly", 0.03), ("ear", 0.08), ("tail", 0.05)):
        soft = moved[:, : creature.body][:, regions[region] > 0.8]
        assert soft.max() > least, f"{region} hardly moves"
        assert soft.max() < 0.6, f"{region} comes off"
    assert moved[:, creature.pins >= 1.0].max() < 1e-4
    eyes_and_claws = moved[:, creature.body :]
    assert eyes_and_claws.max() < 1e-4
    landing = moved[37:42].max()
    assert moved[-2:].max() < 0.3 * landing, "it does not come to rest"


def test_the_script_to_copy_bakes(tmp_path: Path) -> None:
    character = demo_character.build(SMALL)
    demo_motion.play(character.armature, [("Shake", 1, 1, 0)])
    bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 8
    source, target = tmp_path / "in.blend", tmp_path / "out.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(source))
    subprocess.run(
        [sys.executable, EXAMPLES / "bake_one_character.py", source, character.mesh.name, target],
        check=True,
        capture_output=True,
        timeout=120,
    )
    bpy.ops.wm.open_mainfile(filepath=str(target))
    assert blender.baked_range(bpy.data.objects[demo_character.NAME]) == (1, 8)
