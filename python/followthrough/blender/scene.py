# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects of a scene can carry secondary motion, what moves them, and why another one cannot."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from followthrough.blender.actions import has_foreign_animation, played_range, scene_frames
from followthrough.blender.outputs import OutputKind
from followthrough.blender.point_cache import our_modifier
from followthrough.blender.shape_keys import is_absolute_bake, passing_names

#: Modifiers that move vertices one by one and keep their number.
DEFORMING = frozenset(
    "ARMATURE CAST CORRECTIVE_SMOOTH CURVE DISPLACE HOOK LAPLACIANDEFORM LAPLACIANSMOOTH LATTICE MESH_DEFORM "
    "SHRINKWRAP SIMPLE_DEFORM SMOOTH SURFACE_DEFORM WARP WAVE".split()
)
#: Modifiers that move nothing.
STILL = frozenset(
    "COLLISION DATA_TRANSFER DYNAMIC_PAINT NORMAL_EDIT PARTICLE_SYSTEM UV_PROJECT UV_WARP VERTEX_WEIGHT_EDIT "
    "VERTEX_WEIGHT_MIX VERTEX_WEIGHT_PROXIMITY WEIGHTED_NORMAL".split()
)
#: Modifiers that put vertices where a file says, whatever the shape keys are.
REPLACING = frozenset("MESH_CACHE MESH_SEQUENCE_CACHE".split())


class NotBakeableError(ValueError):
    """An object that cannot be baked; the message says why and what to do."""


@dataclass(frozen=True)
class Deformation:
    """What moves a mesh's vertices.

    Attributes
    ----------
    armature : str or None
        Name of the Armature modifier, where a plain one alone moves the mesh; None: it must be sampled.
    skeleton : str or None
        Name of the first armature object that takes part.
    behind : tuple of str
        Modifiers that act on the deformed mesh and do not matter here.
    """

    armature: str | None
    skeleton: str | None
    behind: tuple[str, ...]


def skinned_meshes(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Mesh objects of the scene that an armature moves, in the scene's order."""
    return [obj for obj in scene.objects if obj.type == "MESH" and skeleton_of(obj) is not None]


def why_not_bakeable(obj: bpy.types.Object, output: OutputKind = "keys") -> str | None:
    """Reason why this object cannot be baked, a sentence for the artist; None where it can.

    Quick enough for a panel: coordinates are not looked at (`read_surface` does).
    """
    try:
        require_bakeable(obj, output)
    except NotBakeableError as problem:
        return str(problem)
    return None


def require_bakeable(obj: bpy.types.Object, output: OutputKind = "keys") -> Deformation:
    """Tell what moves this object.

    Parameters
    ----------
    obj
        The object.
    output
        What it is to be baked to.

    Raises
    ------
    NotBakeableError
        Where it cannot be baked.
    """
    name = f"Object '{obj.name}'"
    if obj.type != "MESH":
        raise NotBakeableError(f"{name} is no mesh (it is of type {obj.type.lower()}): choose the character's mesh")
    if output != "pc2":
        _require_own_mesh(obj, name)
    else:
        _require_modifiable(obj, name)
    mesh = obj.data
    if obj.mode != "EDIT" and (not len(mesh.vertices) or not len(mesh.polygons)):
        raise NotBakeableError(f"{name} has an empty mesh: there are no faces to bake")
    _require_usable_keys(obj, name)
    if output == "absolute":
        _require_no_other_keys(obj, name)
    deformation = _deformation(obj, name)
    if output == "pc2" and obj.data.library is not None and deformation.armature is None:
        raise NotBakeableError(
            f"{name} has a linked mesh that something else than the bones of one armature moves: make the mesh local "
            "(Object > Relations > Make Local)"
        )
    return deformation


def skeleton_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The first armature object that moves this mesh."""
    return next(iter(skeletons_of(obj)), None)


def skeletons_of(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """All armature objects that move this mesh."""
    found = [
        modifier.object
        for modifier in obj.modifiers
        if modifier.type == "ARMATURE" and modifier.show_viewport and modifier.object is not None
    ]
    if _is_deformed_by_parent(obj) and obj.parent.type == "ARMATURE":
        found.append(obj.parent)
    return found


def action_frames(obj: bpy.types.Object, scene: bpy.types.Scene) -> tuple[int, int] | None:
    """First and last frame of the scene in which the actions of the mesh's armatures play; None where they play none."""
    times = played_range(skeletons_of(obj))
    return None if times is None else scene_frames(times, scene)


def frame_time(scene: bpy.types.Scene) -> float:
    """From one frame to the next, s."""
    return float(scene.render.fps_base / scene.render.fps)


def evaluated_view_layer(scene: bpy.types.Scene) -> bpy.types.ViewLayer:
    """The view layer that is open where the scene is, else its first one, with a dependency graph."""
    view_layer = bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]
    if view_layer.depsgraph is None:
        view_layer.update()
    return view_layer


def require_posed(obj: bpy.types.Object) -> None:
    """Check that the armatures show their pose.

    Raises
    ------
    NotBakeableError
        Where all of them are switched to their rest position, in which nothing moves.
    """
    armatures = skeletons_of(obj)
    if armatures and all(armature.data.pose_position == "REST" for armature in armatures):
        raise NotBakeableError(
            f"Object '{obj.name}' has its armature '{armatures[0].name}' in Rest Position, where nothing moves: switch it to "
            "Pose Position"
        )


def require_visible(name: str, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
    """Check that Blender poses an object.

    Raises
    ------
    NotBakeableError
        Where it is not in the scene, or hidden.
    """
    obj = scene.objects.get(name)
    if obj is None:
        raise NotBakeableError(f"Object '{name}' is not in scene '{scene.name}'")
    if not obj.visible_get(view_layer=view_layer):
        raise NotBakeableError(f"Object '{name}' is hidden, and Blender does not pose it: show it (and its collection)")


def _is_deformed_by_parent(obj: bpy.types.Object) -> bool:
    return obj.parent is not None and obj.parent_type in {"ARMATURE", "LATTICE"} and obj.parent.type != "MESH"


def _require_own_mesh(obj: bpy.types.Object, name: str) -> None:
    mesh = obj.data
    library = obj.library or mesh.library
    if library is not None or mesh.override_library is not None:
        how = "make the mesh local (Object > Relations > Make Local), or choose Point Cache (PC2) as the output"
        if obj.library is not None:  # where that output cannot be chosen either
            how = (
                "make object and mesh local (Object > Relations > Make Local, All), or override them (Object > Library Override) and "
                "choose Point Cache (PC2) as the output"
            )
        source = f" from {library.filepath}" if library is not None else ""
        raise NotBakeableError(
            f"{name} has a mesh that is linked{source}: its shape keys would be lost when the file is opened again; {how}"
        )
    sharing = sorted(other.name for other in bpy.data.objects if other.data == mesh and other != obj)
    if sharing:
        raise NotBakeableError(
            f"{name} shares its mesh with {', '.join(repr(other) for other in sharing)}, and would move them too: "
            "give it a mesh of its own (Object > Relations > Make Single User)"
        )


def _require_modifiable(obj: bpy.types.Object, name: str) -> None:
    """Check that a Mesh Cache modifier can be put first, and replaces nothing."""
    if obj.library is not None:
        raise NotBakeableError(
            f"{name} is linked from {obj.library.filepath}, and can have no modifier of its own: make the object local, or override "
            "it (Object > Library Override)"
        )
    if _is_deformed_by_parent(obj):
        raise NotBakeableError(
            f"{name} is deformed by its parent before any modifier, where no point cache can act: give it a modifier instead"
        )
    if _has_active_keys(obj.data.shape_keys):
        raise NotBakeableError(
            f"{name} has shape keys that take part, which a point cache would replace: choose shape keys as the output"
        )


def _require_usable_keys(obj: bpy.types.Object, name: str) -> None:
    key = obj.data.shape_keys
    if key is None:
        return
    if not key.use_relative and not is_absolute_bake(key):
        raise NotBakeableError(f"{name} has absolute shape keys: switch on Relative in its Shape Keys panel")
    if obj.show_only_shape_key:
        raise NotBakeableError(f"{name} shows only its active shape key: switch off Solo in its Shape Keys panel")
    animation = key.animation_data
    if animation is not None and animation.use_tweak_mode:
        raise NotBakeableError(f"{name} has a shape key strip that is being tweaked: leave tweak mode first")
    if animation is not None and len(animation.nla_tracks) and (not animation.use_nla or _has_solo_track(animation)):
        raise NotBakeableError(f"{name} has shape key tracks that are switched off or solo: a bake would not play")


def _require_no_other_keys(obj: bpy.types.Object, name: str) -> None:
    key = obj.data.shape_keys
    ours = passing_names(key)
    others = [] if key is None else [block.name for block in key.key_blocks[1:] if block.name not in ours]
    if others or has_foreign_animation(key):
        raise NotBakeableError(
            f"{name} has other shape keys ({', '.join(map(repr, others)) or 'animated'}), which absolute ones would switch off: choose "
            "(relative) shape keys as the output"
        )


def _has_solo_track(animation: bpy.types.AnimData) -> bool:
    return any(track.is_solo for track in animation.nla_tracks)


def _deformation(obj: bpy.types.Object, name: str) -> Deformation:
    chain: list[bpy.types.Modifier] = []
    behind: list[str] = []
    generator: str | None = None
    ours = our_modifier(obj)
    for modifier in obj.modifiers:
        if not modifier.show_viewport or modifier.type in STILL or _is_idle(modifier) or modifier.name == ours:
            continue
        if modifier.type in REPLACING:
            raise NotBakeableError(f"{name} has the modifier '{modifier.name}', which replaces what shape keys do")
        if generator is not None and modifier.type in DEFORMING and (modifier.type == "ARMATURE" or not chain):
            raise NotBakeableError(
                f"{name} is deformed by '{modifier.name}' after '{generator}' has made new vertices, which shape keys "
                f"cannot reach: apply '{generator}', or move it below"
            )
        if generator is None and modifier.type in DEFORMING:
            chain.append(modifier)
        else:
            generator = generator or modifier.name
            behind.append(modifier.name)
    skeleton = skeleton_of(obj)
    if not chain and not _is_deformed_by_parent(obj):
        hidden = [modifier.name for modifier in obj.modifiers if modifier.type == "ARMATURE" and not _is_idle(modifier)]
        if hidden:
            raise NotBakeableError(
                f"{name} has its modifier '{hidden[0]}' switched off in the viewport: switch it on, or nothing moves the mesh"
            )
        raise NotBakeableError(f"{name} is moved by no armature: give it an Armature modifier with an armature object")
    plain = len(chain) == 1 and _is_plain(obj, chain[0]) and not _has_active_keys(obj.data.shape_keys)
    return Deformation(
        armature=chain[0].name if plain and not _is_deformed_by_parent(obj) else None,
        skeleton=skeleton.name if skeleton is not None else None,
        behind=tuple(behind),
    )


def _is_idle(modifier: bpy.types.Modifier) -> bool:
    needs_object = modifier.type in {"ARMATURE", "CURVE", "HOOK", "LATTICE", "MESH_DEFORM"}
    return needs_object and modifier.object is None


def _is_plain(obj: bpy.types.Object, modifier: bpy.types.Modifier) -> bool:
    """Whether bone matrices and vertex groups tell all that this modifier does."""
    if modifier.type != "ARMATURE" or modifier.use_bone_envelopes or not modifier.use_vertex_groups:
        return False
    if modifier.vertex_group or modifier.use_multi_modifier:
        return False
    groups = {group.name for group in obj.vertex_groups}
    bones = [bone for bone in modifier.object.data.bones if bone.use_deform and bone.name in groups]
    return not any(bone.bbone_segments > 1 or bone.use_envelope_multiply for bone in bones)


def _has_active_keys(key: bpy.types.Key | None) -> bool:
    """Whether shape keys of others take part in the deformation, now or in another frame."""
    if key is None:
        return False
    ours = passing_names(key)
    others = [block for block in key.key_blocks[1:] if block.name not in ours and not block.mute]
    if not others:
        return False
    return any(block.value != 0.0 for block in others) or has_foreign_animation(key)
