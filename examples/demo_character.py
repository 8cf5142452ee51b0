# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo creature in Blender: mesh, armature, skin weights, material, painted groups and actions, all made by script.

    import bpy, demo_character
    character = demo_character.build()          # about 9,000 vertices; build(vertices=14000) for a benchmark

The same number of vertices gives the same character every time. It is CC0: do with it what you like.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

import demo_motion
from demo_creature import Creature, all_bones, make_creature
from followthrough.blender import MASS_GROUP, PINS_GROUP, STIFFNESS_GROUP, write_group
from followthrough.settings import Settings, VolumeSettings

#: Name of the mesh object; the armature's is this with " rig".
NAME = "Bumble"

#: What moves it: the emulator, or what bakes by default where that has no weights, in cells that ears are a few thick of, a
#: little farther than is natural.
MOTION = Settings(volume=VolumeSettings(cells=32), amplitude=1.25)

#: What plays in the demo: action, first frame, repetitions, frames to blend in.
SHOW = [("Walk", 1, 2, 0), ("Jump", 36, 1, 8), ("Shake", 82, 1, 4)]


@dataclass(frozen=True)
class DemoCharacter:
    """The character's objects, and the arrays they were made from."""

    mesh: bpy.types.Object
    armature: bpy.types.Object
    creature: Creature


def build(vertices: int = 9000, painted: bool = True) -> DemoCharacter:
    """Build the creature in the current scene.

    Parameters
    ----------
    vertices
        About how many vertices the mesh gets; 2,000 or more.
    painted
        Whether stiffness, mass and pins are painted; skin weights always are.
    """
    creature = make_creature(vertices)
    armature = _build_armature()
    mesh = _build_mesh(creature)
    mesh.parent = armature
    modifier = mesh.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    for bone, weights in zip(creature.bones, creature.weights.T, strict=True):
        _add_group(mesh, bone, weights)
    if painted:
        write_group(mesh, STIFFNESS_GROUP, creature.stiffness)
        write_group(mesh, MASS_GROUP, creature.mass)
        write_group(mesh, PINS_GROUP, creature.pins)
    demo_motion.make_actions(armature)
    return DemoCharacter(mesh, armature, creature)


def show(character: DemoCharacter) -> None:
    """Let the character walk, jump and shake itself, in a scene with a floor, a lamp and a camera."""
    scene = bpy.context.scene
    scene.render.fps, scene.render.fps_base = demo_motion.FPS, 1.0
    scene.frame_start = 1
    scene.frame_end = demo_motion.play(character.armature, SHOW)
    scene.frame_set(1)

    floor = bpy.data.meshes.new("Floor")
    floor.from_pydata([(-6, -6, 0), (6, -6, 0), (6, 6, 0), (-6, 6, 0)], [], [(0, 1, 2, 3)])
    floor.materials.append(_material("Floor", (0.62, 0.57, 0.50, 1.0), None))
    _link(bpy.data.objects.new("Floor", floor))
    lamp = bpy.data.lights.new("Lamp", "SUN")
    lamp.energy, lamp.angle = 3.0, 0.15
    _aim(_link(bpy.data.objects.new("Lamp", lamp)), (2.5, -3.1, 4.3), (0.0, 0.0, 0.0))
    lens = bpy.data.cameras.new("Camera")
    lens.lens = 60.0
    camera = _link(bpy.data.objects.new("Camera", lens))
    _aim(camera, (3.0, -6.0, 1.9), (0.0, 0.0, 0.95))
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = 1080, 1080
    world = bpy.data.worlds.new("World")
    world.color = (0.55, 0.60, 0.66)
    scene.world = world
    for screen in bpy.data.screens:  # open in the camera's view, with colours
        for area in (area for area in screen.areas if area.type == "VIEW_3D"):
            area.spaces[0].shading.type = "MATERIAL"
            area.spaces[0].region_3d.view_perspective = "CAMERA"


def evaluated_positions(obj: bpy.types.Object) -> NDArray[np.float64]:
    """Vertices of an object as Blender shows it in the current frame: (v, 3), in the world."""
    evaluated = obj.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    positions = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", positions)
    evaluated.to_mesh_clear()
    world = np.array(evaluated.matrix_world)
    return positions.reshape(-1, 3).astype(np.float64) @ world[:3, :3].T + world[:3, 3]


def _build_armature() -> bpy.types.Object:
    data = bpy.data.armatures.new(f"{NAME} rig")
    armature = _link(bpy.data.objects.new(f"{NAME} rig", data))
    armature.show_in_front = True
    data.display_type = "STICK"
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for name, (head, tail, parent) in all_bones().items():
        bone = data.edit_bones.new(name)
        bone.head, bone.tail = head, tail
        if parent is not None:
            bone.parent = data.edit_bones[parent]
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def _build_mesh(creature: Creature) -> bpy.types.Object:
    data = bpy.data.meshes.new(NAME)
    data.from_pydata(creature.vertices.tolist(), [], creature.faces)
    data.shade_smooth()
    colours = data.color_attributes.new("Colour", "FLOAT_COLOR", "POINT")
    rgba = np.column_stack([creature.colours, np.ones(len(creature.colours))])
    colours.data.foreach_set("color", rgba.astype(np.float32).ravel())
    data.materials.append(_material(NAME, (0.2, 0.6, 0.6, 1.0), "Colour"))
    return _link(bpy.data.objects.new(NAME, data))


def _material(name: str, colour: tuple[float, float, float, float], attribute: str | None) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.diffuse_color = colour
    if material.node_tree is None:
        material.use_nodes = True
    nodes = material.node_tree.nodes
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Roughness"].default_value = 0.6
    shader.inputs["Base Color"].default_value = colour
    if attribute is not None:
        painted = nodes.new("ShaderNodeAttribute")
        painted.attribute_name = attribute
        painted.location = (-260.0, 200.0)
        material.node_tree.links.new(painted.outputs["Color"], shader.inputs["Base Color"])
    return material


def _add_group(obj: bpy.types.Object, name: str, values: NDArray[np.float64]) -> None:
    group = obj.vertex_groups.new(name=name)
    for vertex in np.flatnonzero(values > 0):
        group.add([int(vertex)], float(values[vertex]), "REPLACE")


def _link(obj: bpy.types.Object) -> bpy.types.Object:
    bpy.context.scene.collection.objects.link(obj)
    return obj


def _aim(obj: bpy.types.Object, position: tuple[float, float, float], target: tuple[float, float, float]) -> None:
    obj.location = position
    obj.rotation_euler = (Vector(target) - Vector(position)).to_track_quat("-Z", "Y").to_euler()
