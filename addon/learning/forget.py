# SPDX-License-Identifier: GPL-3.0-or-later
"""Forget Learned Springs: back to what is painted."""

import bpy
from bpy.types import Operator

from followthrough.blender import has_learned, remove_learned

from ..bake.session import idle
from ..characters import selected_characters, why_not_editable
from . import heat_map


class FOLLOWTHROUGH_OT_forget_learned(Operator):
    bl_idname = "followthrough.forget_learned"
    bl_label = "Forget Learned Springs"
    bl_description = "Take the learned springs off the selected characters, which then swing as they are painted"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        if not any(map(has_learned, selected_characters(context))):
            cls.poll_message_set("Nothing was learned")
            return False
        for reason in filter(None, map(why_not_editable, selected_characters(context))):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        for obj in selected_characters(context):
            heat_map.hide(obj)
            remove_learned(obj)
        return {"FINISHED"}
