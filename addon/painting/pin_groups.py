# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of vertex groups that pin a character, each with its own strength."""

import bpy
from bpy.types import Operator

from followthrough.blender import PINS_GROUP

from ..characters import active_character, why_not_editable, why_not_settable


class FOLLOWTHROUGH_OT_add_pin_group(Operator):
    bl_idname = "followthrough.add_pin_group"
    bl_label = "Add Pin Group"
    bl_description = "Pin with one more vertex group; where several overlap, the strongest wins"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None:
            return False
        if reason := why_not_editable(obj):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        if obj is None:
            return {"CANCELLED"}
        settings = obj.followthrough
        name = PINS_GROUP
        if PINS_GROUP not in obj.vertex_groups or PINS_GROUP in settings.pin_groups:
            # Blender makes the name unique where it is taken.
            name = obj.vertex_groups.new(name=PINS_GROUP).name
            settings.made_groups.add().name = name
        settings.pin_groups.add().name = name
        settings.active_pin_group = len(settings.pin_groups) - 1
        return {"FINISHED"}


class FOLLOWTHROUGH_OT_remove_pin_group(Operator):
    bl_idname = "followthrough.remove_pin_group"
    bl_label = "Remove Pin Group"
    bl_description = "Do not pin with this vertex group any more; the group and its weights stay on the mesh"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None or obj.followthrough.active_pin_group >= len(obj.followthrough.pin_groups):
            cls.poll_message_set("There is no pin group in the list")
            return False
        if reason := why_not_settable(obj):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        if obj is None:
            return {"CANCELLED"}
        settings = obj.followthrough
        try:
            settings.pin_groups.remove(settings.active_pin_group)
        except TypeError:  # what a library override takes over can only be changed
            self.report({"ERROR"}, "This pin group comes from another file: set its strength to 0 instead")
            return {"CANCELLED"}
        settings.active_pin_group = max(0, min(settings.active_pin_group, len(settings.pin_groups) - 1))
        return {"FINISHED"}
