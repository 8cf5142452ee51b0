# SPDX-License-Identifier: GPL-3.0-or-later
"""Remove Followthrough: takes a character back to what it was before Add."""

import bpy
from bpy.types import Operator

from followthrough.blender import clear, remove_groups, remove_learned

from ..bake.session import idle
from ..characters import selected_characters, why_not_settable
from ..learning import heat_map
from ..preview import live


class FOLLOWTHROUGH_OT_remove(Operator):
    bl_idname = "followthrough.remove"
    bl_label = "Remove Followthrough"
    bl_description = (
        "Take Followthrough off the selected characters: the bake, what was learned, the vertex groups that it made with what "
        "is painted on them, and the settings. Everything else stays"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        if not selected_characters(context):
            cls.poll_message_set("The active object has no Followthrough")
            return False
        for reason in filter(None, map(why_not_settable, selected_characters(context))):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        live.end()
        names = [obj.name for obj in selected_characters(context)]
        shared = {name: remove(context, name) for name in names}
        kept = [
            f"{name} shares its mesh with {', '.join(others)}: bake and paint stay on it"
            for name, others in shared.items()
            if others
        ]
        self.report({"INFO"}, ". ".join([f"Removed Followthrough from {', '.join(names)}", *kept]))
        return {"FINISHED"}


def remove(context: bpy.types.Context, name: str) -> list[str]:
    """Take it off one object; what is on its mesh stays where other characters, whose names are returned, have that mesh, too."""
    obj = context.scene.objects[name]
    others = [
        other.name
        for other in bpy.data.objects
        if other != obj
        and other.library is None
        and other.type == "MESH"
        and other.data == obj.data
        and other.followthrough.is_added
    ]
    if others:
        obj.property_unset("followthrough")
        return others
    made = [group.name for group in obj.followthrough.made_groups]
    painted = obj.vertex_groups.active
    if obj.mode == "WEIGHT_PAINT" and obj == context.object and painted is not None and painted.name in made:
        bpy.ops.object.mode_set(mode="OBJECT")
    if obj.library is None:
        clear(obj)
    if obj.data.library is None:
        heat_map.hide(obj)
        remove_learned(obj)
        remove_groups(obj, made, obj.followthrough.previous_group)
    obj.property_unset("followthrough")
    return []
