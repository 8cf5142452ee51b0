# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects the add-on's buttons act on."""

import bpy


def active_mesh(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where it is a mesh."""
    obj = context.object
    return obj if obj is not None and obj.type == "MESH" else None


def active_character(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where Followthrough was added to it."""
    obj = active_mesh(context)
    return obj if obj is not None and obj.followthrough.is_added else None


def selected_characters(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The active character and those selected with it, which are baked together."""
    active = active_character(context)
    if active is None:
        return []
    others = (obj for obj in context.selected_objects if obj.type == "MESH" and obj.followthrough.is_added)
    return [active, *(obj for obj in others if obj != active)]


def meshes_of_armature(scene: bpy.types.Scene, armature: bpy.types.Object) -> list[bpy.types.Object]:
    """Visible meshes that this armature moves."""
    return [
        obj
        for obj in scene.objects
        if obj.type == "MESH"
        and obj.visible_get()
        and any(modifier.type == "ARMATURE" and modifier.object == armature for modifier in obj.modifiers)
    ]
