# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes and armatures as the plain arrays of `followthrough.character`: a surface once, a pose a frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Protocol

import bpy
import numpy as np

from followthrough.affine import inverse_affine
from followthrough.blender import probes
from followthrough.blender.modes import object_mode
from followthrough.blender.outputs import OutputKind
from followthrough.blender.scene import Deformation, NotBakeableError, require_bakeable, skeleton_of
from followthrough.blender.shape_keys import read_points
from followthrough.blender.vertex_weights import VertexWeights, read_weights
from followthrough.character import BonePose, FloatArray, IntArray, Pose, Rig, Surface


class PoseReader(Protocol):
    """Reads an object's pose in the scene's current frame."""

    def read(self, view_layer: bpy.types.ViewLayer) -> Pose:
        """Read it from the view layer's evaluated state."""


def read_surface(obj: bpy.types.Object, weights: VertexWeights | None = None, output: OutputKind = "keys") -> Surface:
    """Read a mesh object at rest, with its rig where a plain Armature modifier alone moves it.

    Parameters
    ----------
    obj
        The object.
    weights
        What `read_weights` gave for it, where the caller has that already: nothing takes longer to read.
    output
        What it is to be baked to.

    Raises
    ------
    NotBakeableError
        Where the object cannot be baked.
    """
    deformation = require_bakeable(obj, output)
    surface = read_bare_surface(obj)
    return surface if deformation.armature is None else with_skeleton(obj, surface, weights)


def read_bare_surface(obj: bpy.types.Object) -> Surface:
    """The same without the rig, and thus without a look at the weights: all that a volume's tets are made of.

    Raises
    ------
    NotBakeableError
        Where the mesh is empty, not finite or flat.
    """
    with object_mode(obj.name):
        positions = rest_positions(obj)
        triangles = _triangles(obj.data)
    name = f"Object '{obj.name}'"
    if not len(triangles):
        raise NotBakeableError(f"{name} has an empty mesh: there are no faces to bake")
    if not np.isfinite(positions).all():
        vertex = int(np.flatnonzero(~np.isfinite(positions).all(axis=1))[0])
        raise NotBakeableError(
            f"{name} has coordinates that are no numbers (NaN or infinity), first at vertex {vertex}"
        )
    armature = skeleton_of(obj)
    scale = _stretch(obj) * (1.0 if armature is None else _shared_bone_scale(armature))
    return Surface(
        rest_positions=positions,
        triangles=triangles,
        object_scale=scale,
        character_size=None if armature is None else _character_size(obj, armature, positions, scale),
    )


def with_skeleton(obj: bpy.types.Object, surface: Surface, weights: VertexWeights | None = None) -> Surface:
    """The same surface with the rig of the first armature that moves it, if there is one."""
    armature = skeleton_of(obj)
    if armature is None or surface.rig is not None:
        return surface
    modifier = _armature_modifier(obj)
    painted = weights or read_weights(obj)
    used = set(np.flatnonzero(np.bincount(painted.groups)).tolist())
    group_of_bone = {group.name: group.index for group in obj.vertex_groups if group.index in used}
    bones = [bone.name for bone in armature.data.bones if bone.use_deform and bone.name in group_of_bone]
    bone_indices, bone_weights = painted.table({group_of_bone[name]: index for index, name in enumerate(bones)})
    if not bone_weights.any():
        raise NotBakeableError(
            f"Object '{obj.name}' has no weights for the deforming bones of '{armature.name}': parent it with weights"
        )
    to_mesh = np.linalg.inv(_matrix(obj)) @ _matrix(armature)
    ends = np.array([[bone.head_local, bone.tail_local] for bone in (armature.data.bones[name] for name in bones)])
    joints = np.array(_joint_lines(armature, bones))
    rig = Rig(
        bone_indices=bone_indices,
        bone_weights=bone_weights,
        bone_segments=ends @ to_mesh[:3, :3].T + to_mesh[:3, 3],
        skinning="dual-quaternion" if modifier is not None and modifier.use_deform_preserve_volume else "linear",
        bone_rest_matrices=np.array([armature.data.bones[name].matrix_local for name in bones], dtype=np.float64),
        bone_names=tuple(bones),
        skeleton=joints @ to_mesh[:3, :3].T + to_mesh[:3, 3],
    )
    return dataclasses.replace(surface, rig=rig)


def _joint_lines(armature: bpy.types.Object, names: list[str]) -> list[list[Any]]:
    """From every bone's head to its children's heads, to its own tail where it is the last.

    Other tails do not count: importers let them point anywhere.
    """
    lines = []
    for bone in (armature.data.bones[name] for name in names):
        children = [child.head_local for child in bone.children if child.name in names]
        lines += [[bone.head_local, end] for end in children or [bone.tail_local]]
    return lines


def rest_positions(obj: bpy.types.Object) -> FloatArray:
    """Coordinates of the Basis, (v, 3) in object space."""
    mesh = obj.data
    if mesh.shape_keys is not None:
        return read_points(mesh.shape_keys.reference_key).astype(np.float64)
    positions = np.empty(len(mesh.vertices) * 3, dtype=np.float32)
    mesh.vertices.foreach_get("co", positions)
    return positions.reshape(-1, 3).astype(np.float64)


def make_reader(obj: bpy.types.Object, deformation: Deformation, surface: Surface) -> PoseReader:
    """Reader of this object's poses: bone matrices where a rig tells all, deformed vertices otherwise."""
    if surface.rig is None:
        return probes.SampleReader(obj.name, len(surface.rest_positions))
    assert deformation.skeleton is not None
    return BoneReader(obj, bpy.data.objects[deformation.skeleton], surface.rig.bone_names)


class BoneReader:
    """Reads the matrices of those bones that a mesh hangs on."""

    def __init__(self, obj: bpy.types.Object, armature: bpy.types.Object, bones: Sequence[str]) -> None:
        self._object = obj.name
        self._armature = armature.name
        order = {bone.name: index for index, bone in enumerate(armature.pose.bones)}
        self._bones = np.array([order[name] for name in bones], dtype=np.intp)
        self._count = len(order)

    def read(self, view_layer: bpy.types.ViewLayer) -> BonePose:
        """Read the pose from the view layer's evaluated state."""
        mesh = probes.evaluated(self._object, view_layer)
        armature = probes.evaluated(self._armature, view_layer)
        if len(armature.pose.bones) != self._count:
            raise NotBakeableError(f"Object '{self._armature}' has other bones than before: bake again")
        channels = _channels(armature)[self._bones]
        world, armature_world = probes.world_matrix(mesh), probes.world_matrix(armature)
        to_mesh = inverse_affine(world) @ armature_world
        to_armature = inverse_affine(armature_world) @ world
        with np.errstate(invalid="ignore", over="ignore"):  # whoever asked for the pose checks it
            matrices = to_mesh @ channels @ to_armature
        return BonePose(bone_matrices=np.asarray(matrices, dtype=np.float64), world=world, armature=to_mesh)


def _armature_modifier(obj: bpy.types.Object) -> bpy.types.Modifier | None:
    for modifier in obj.modifiers:
        if modifier.type == "ARMATURE" and modifier.show_viewport and modifier.object is not None:
            return modifier
    return None


def _matrix(obj: bpy.types.Object) -> FloatArray:
    return np.array(obj.matrix_world, dtype=np.float64)


def _stretch(obj: bpy.types.Object) -> FloatArray:
    """Symmetric factor of the object's matrix, in its polar decomposition."""
    _, stretches, axes = np.linalg.svd(_matrix(obj)[:3, :3])
    if not stretches.min() > 1e-6 * stretches.max():
        raise NotBakeableError(
            f"Object '{obj.name}' is flat: its scale is 0 along some axis; apply or change its scale"
        )
    stretch: FloatArray = axes.T * stretches @ axes
    return stretch


def _shared_bone_scale(armature: bpy.types.Object) -> float:
    """How much larger than at rest the pose makes the whole character, by its deforming bones' volumes.

    A few bones that squash and stretch do not count, a scaled root does.
    """
    deforming = [index for index, bone in enumerate(armature.pose.bones) if bone.bone.use_deform]
    if not deforming:
        return 1.0
    volumes = np.abs(np.linalg.det(_channels(armature)[deforming, :3, :3]))
    scale = float(np.cbrt(np.median(volumes)))
    return scale if np.isfinite(scale) and scale > 0.0 and abs(scale - 1.0) > 1e-3 else 1.0


def _character_size(
    obj: bpy.types.Object, armature: bpy.types.Object, positions: FloatArray, scale: FloatArray
) -> float:
    """Longest side at rest of the mesh and the armature's joints, metres."""
    joints = [bone.head_local for bone in armature.data.bones if bone.use_deform]
    to_mesh = np.linalg.inv(_matrix(obj)) @ _matrix(armature)
    inside = np.array(joints, dtype=np.float64).reshape(-1, 3) @ to_mesh[:3, :3].T + to_mesh[:3, 3]
    return float(np.ptp(np.concatenate([positions, inside]) @ scale.T, axis=0).max())


def _channels(armature: bpy.types.Object) -> FloatArray:
    """From rest to pose in the armature's space, (b, 4, 4), of all its bones."""
    # Blender stores matrices column by column.
    channels = np.empty(len(armature.pose.bones) * 16, dtype=np.float32)
    armature.pose.bones.foreach_get("matrix_channel", channels)
    return channels.reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def _triangles(mesh: bpy.types.Mesh) -> IntArray:
    mesh.calc_loop_triangles()
    triangles = np.empty(len(mesh.loop_triangles) * 3, dtype=np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    return triangles.reshape(-1, 3)
