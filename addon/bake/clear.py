# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear: takes back exactly what a bake made."""

import bpy
from bpy.types import Operator

from followthrough.blender import baked_range, clear

from ..characters import selected_characters
from ..preview import live
from .session import idle


class FOLLOWTHROUGH_OT_clear(Operator):
    bl_idname = "followthrough.clear"
    bl_label = "Clear Followthrough"
    bl_description = (
        "Remove the baked shape keys of the selected characters and their animation; "
        "painted groups, settings and all other shape keys stay"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        if not any(baked_range(obj) for obj in selected_characters(context)):
            cls.poll_message_set("Nothing is baked")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        live.end()
        names = [obj.name for obj in selected_characters(context)]
        try:
            cleared = [name for name in names if clear(context.scene.objects[name])]
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"Cleared the bake of {', '.join(cleared)}")
        return {"FINISHED"}
