# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects the add-on's buttons act on."""

import bpy

from followthrough.blender import MASS_GROUP, STIFFNESS_GROUP

_CHOOSE_PINS = "choose another one under Paint, Pin Groups, or take it out of the list with -"


def active_mesh(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where it is a mesh."""
    obj = context.object
    return obj if obj is not None and obj.type == "MESH" else None


def active_character(context: bpy.types.Context) -> bpy.types.Object | None:
    """The active object where Followthrough was added to it."""
    obj = active_mesh(context)
    return obj if obj is not None and obj.followthrough.is_added else None


def why_not_editable(obj: bpy.types.Object) -> str | None:
    """Reason why nothing can be kept on this object's mesh (groups, colours, what was learned); None where it can."""
    mesh = obj.data
    library = mesh.library if mesh.library is not None else obj.library
    if library is not None:
        return (
            f"The mesh of '{obj.name}' is linked from {library.filepath}, and what is changed on it would be lost: change it in "
            "that file, or make it local (Object > Relations > Make Local)"
        )
    if mesh.override_library is not None:
        return (
            f"The mesh of '{obj.name}' overrides a linked one, and what is changed on it would be lost: make it local "
            "(Object > Relations > Make Local)"
        )
    return None


def why_not_settable(obj: bpy.types.Object) -> str | None:
    """Reason why nothing can be set on this object; None where it can."""
    if obj.library is None:
        return None
    return (
        f"'{obj.name}' is linked from {obj.library.filepath}, and what is changed on it would be lost: make it local "
        "(Object > Relations > Make Local), or override it (Object > Library Override)"
    )


def missing_groups(obj: bpy.types.Object) -> list[str]:
    """Groups of stiffness and mass that a character does not have any more, for which suggested values are baked."""
    names = (STIFFNESS_GROUP, MASS_GROUP) if obj.data.library is None else ()
    return [name for name in names if name not in obj.vertex_groups]


def why_not_pinned(obj: bpy.types.Object) -> str | None:
    """Which pin group a character has not got, and what to do; None where it has all of them."""
    for pin in obj.followthrough.pin_groups:
        if not pin.name:
            return f"'{obj.name}' has a pin group for which no vertex group is chosen: {_CHOOSE_PINS}"
        if pin.name not in obj.vertex_groups:
            return f"'{obj.name}' has no vertex group '{pin.name}' any more, which should pin it: {_CHOOSE_PINS}"
    return None


def require_pinned(obj: bpy.types.Object) -> None:
    """Raise ValueError with that reason."""
    if reason := why_not_pinned(obj):
        raise ValueError(reason)


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
