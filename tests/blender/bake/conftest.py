# SPDX-License-Identifier: GPL-3.0-or-later
"""A small character that every test of the bake builds anew: a soft column on two bones, the upper one swinging."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray
from plain_network import random_parameters

from followthrough.blender import (
    Bake,
    BakeReport,
    FrameRange,
    ObjectSettings,
    groups,
    read_paint,
    read_surface,
    write_group,
)
from followthrough.blender.rig_reading import make_reader
from followthrough.blender.scene import require_bakeable
from followthrough.blender.shape_keys import our_names, read_points
from followthrough.character import Paint, Surface, flesh_thickness
from followthrough.emulator_weights import EmulatorWeights, TrainedOn
from followthrough.secondary_motion import SecondaryMotion
from followthrough.settings import Settings, VolumeSettings

RINGS, SEGMENTS = 9, 8

SMALL_NETWORK = {"inertia": (8, 8), "force": (12, 8), "displacement": (16,)}

#: A coarse volume, so that a test takes no time.
COARSE = Settings(solver="springs", volume=VolumeSettings(cells=8))


@dataclass
class Character:
    """Names of a character's objects; references would not survive undo or a reload."""

    mesh_name: str
    armature_name: str
    size: float

    @property
    def mesh(self) -> Any:
        return bpy.data.objects[self.mesh_name]

    @property
    def armature(self) -> Any:
        return bpy.data.objects[self.armature_name]

    @property
    def modifier(self) -> Any:
        return self.mesh.modifiers["Armature"]

    def positions(self, frame: float | None = None, world: bool = True) -> NDArray[np.float64]:
        """Evaluated vertices (v, 3) in a frame, as Blender shows them."""
        scene = bpy.context.scene
        if frame is not None:
            scene.frame_set(math.floor(frame), subframe=frame - math.floor(frame))
        evaluated = self.mesh.evaluated_get(bpy.context.evaluated_depsgraph_get())
        points = np.empty(len(evaluated.data.vertices) * 3, dtype=np.float32)
        evaluated.data.vertices.foreach_get("co", points)
        points = points.reshape(-1, 3).astype(np.float64)
        matrix = np.array(evaluated.matrix_world, dtype=np.float64)
        return points @ matrix[:3, :3].T + matrix[:3, 3] if world else points

    def skinned(self, frame: float) -> NDArray[np.float64]:
        """The same without our shape keys."""
        key = self.mesh.data.shape_keys
        keys = [block for block in key.key_blocks if block.name in our_names(key)]
        for block in keys:
            block.mute = True
        positions = self.positions(frame)
        for block in keys:
            block.mute = False
        return positions

    def displacements(self, start: int, end: int, settings: Settings = COARSE) -> list[NDArray[np.float64]]:
        """What these settings give in every frame, simulated step by step beside the bake."""
        scene = bpy.context.scene
        scene.frame_set(start)
        surface = read_surface(self.mesh)
        paint = read_paint(self.mesh, surface)
        motion = SecondaryMotion(surface, paint, settings, scene.render.fps_base / scene.render.fps)
        reader = make_reader(self.mesh, require_bakeable(self.mesh), surface)
        poses = []
        for frame in range(start, end + 1):
            scene.frame_set(frame)
            poses.append(reader.read(bpy.context.view_layer))
        steps = [motion.reset(poses[0])]
        steps += [motion.step(pose, after) for pose, after in zip(poses[1:], [*poses[2:], None], strict=True)]
        return [step.displacements for step in steps]

    def bake(self, settings: ObjectSettings | None = None, frames: FrameRange | None = None) -> BakeReport:
        """Bake this character alone."""
        bake = Bake(bpy.context.scene, {self.mesh_name: settings or ObjectSettings(motion=COARSE)}, frames)
        for _ in bake.run():
            pass
        return bake.finish()

    def offsets(self) -> NDArray[np.float32]:
        """What our shape keys add to the Basis, (frames, v, 3)."""
        key = self.mesh.data.shape_keys
        blocks = [block for block in key.key_blocks if block.name in our_names(key)]
        return np.array([read_points(block) - read_points(key.reference_key) for block in blocks])


def build_character(
    name: str = "Creature",
    size: float = 1.0,
    frames: int = 8,
    preserve_volume: bool = False,
    seam: bool = False,
    animate: bool = True,
) -> Character:
    """A column of height 2 `size` on the bones Lower and Upper; Upper swings about x and back within `frames`."""
    angles = np.linspace(0.0, 2.0 * math.pi, SEGMENTS, endpoint=False)
    heights = np.linspace(0.0, 2.0, RINGS)
    ring = np.column_stack([0.4 * np.cos(angles), 0.4 * np.sin(angles)])
    vertices = [(x * size, y * size, z * size) for z in heights for x, y in ring]
    faces = [
        (
            r * SEGMENTS + s,
            r * SEGMENTS + (s + 1) % SEGMENTS,
            (r + 1) * SEGMENTS + (s + 1) % SEGMENTS,
            (r + 1) * SEGMENTS + s,
        )
        for r in range(RINGS - 1)
        for s in range(SEGMENTS)
    ]
    faces += [tuple(reversed(range(SEGMENTS))), tuple(range((RINGS - 1) * SEGMENTS, RINGS * SEGMENTS))]
    if seam:  # the last face hangs on vertices of its own, at the same places
        first = len(vertices)
        vertices += [vertices[index] for index in faces[-1]]
        faces[-1] = tuple(range(first, first + SEGMENTS))
    data = bpy.data.meshes.new(name)
    data.from_pydata(vertices, [], faces)
    mesh = bpy.data.objects.new(name, data)
    rig = bpy.data.armatures.new(f"{name} rig")
    armature = bpy.data.objects.new(f"{name} rig", rig)
    for obj in (mesh, armature):
        bpy.context.scene.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    lower = rig.edit_bones.new("Lower")
    lower.head, lower.tail = (0, 0, 0), (0, 0, size)
    upper = rig.edit_bones.new("Upper")
    upper.head, upper.tail = (0, 0, size), (0, 0, 2 * size)
    upper.parent = lower
    bpy.ops.object.mode_set(mode="OBJECT")
    groups = {bone: mesh.vertex_groups.new(name=bone) for bone in ("Lower", "Upper")}
    for index, (_, _, z) in enumerate(vertices):
        share = min(1.0, max(0.0, (z / size - 0.7) / 0.6))
        # Not normalised, on purpose: the Armature modifier divides by the sum.
        if share < 1.0:
            groups["Lower"].add([index], 0.6 * (1.0 - share), "REPLACE")
        if share > 0.0:
            groups["Upper"].add([index], 0.6 * share, "REPLACE")
    modifier = mesh.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    modifier.use_deform_preserve_volume = preserve_volume
    mesh.parent = armature
    bone = armature.pose.bones["Upper"]
    bone.rotation_mode = "XYZ"
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, frames
    if animate:
        for frame, angle in ((1, 0.0), (1 + (frames - 1) / 2, 0.9), (frames, 0.0)):
            bone.rotation_euler.x = angle
            bone.keyframe_insert("rotation_euler", frame=frame)
    scene.frame_set(1)
    return Character(mesh.name, armature.name, 2.0 * size)


@pytest.fixture
def make_character() -> Callable[..., Character]:
    """Builder of characters."""
    return build_character


@pytest.fixture
def character() -> Character:
    """The usual one."""
    return build_character()


@pytest.fixture
def weights(tmp_path: Path) -> Path:
    """A small network of random weights, which moves flesh somehow."""
    path = tmp_path / "network.npz"
    EmulatorWeights(random_parameters(0, **SMALL_NETWORK), TrainedOn(stiffness_range=(0.01, 150.0))).save(path)
    return path


def paint_by_depth(surface: Surface, *_tets: object) -> Paint:
    """Skin near a bone is pinned, and softer the farther it is from one."""
    thickness = flesh_thickness(surface)
    if surface.rig is None or thickness <= 0:
        neutral = np.full(len(surface.rest_positions), 0.5)
        return Paint(stiffness=neutral, mass=neutral.copy(), pins=np.zeros(len(neutral)))
    depth = surface.bone_distances / thickness
    fade = np.clip((0.6 - depth) / 0.25, 0.0, 1.0)
    return Paint(
        stiffness=np.clip(1.25 - depth, 0.0, 1.0),
        mass=np.full(len(depth), 0.5),
        pins=fade * fade * (3.0 - 2.0 * fade),
    )


@pytest.fixture(autouse=True)
def known_paint(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is suggested: what is tested here of baking needs a motion that is known. What is suggested has tests of its own."""
    if not request.module.__name__.endswith("test_groups"):
        monkeypatch.setattr(groups, "suggest_paint", paint_by_depth)


@pytest.fixture
def held(character: Character) -> Character:
    """The column with its lower third pinned, a soft collar, and the rest free."""
    heights = np.array([vertex.co.z for vertex in character.mesh.data.vertices]) / character.size
    write_group(character.mesh, "Followthrough Pins", np.where(heights < 0.3, 1.0, np.where(heights < 0.45, 0.4, 0.0)))
    return character
