# SPDX-License-Identifier: GPL-3.0-or-later
"""Discard Stopped Bake: the next bake begins with its first frame."""

import bpy
from bpy.types import Operator

from ..characters import selected_characters
from ..properties.bake_settings import frame_range, object_settings
from .session import discard, idle, resumable


class FOLLOWTHROUGH_OT_discard_stopped_bake(Operator):
    bl_idname = "followthrough.discard_stopped_bake"
    bl_label = "Discard Stopped Bake"
    bl_description = "Delete the frames that a stopped bake has finished, so that the next one begins anew"
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        characters = selected_characters(context)
        objects = {obj.name: object_settings(obj) for obj in characters}
        if not characters or resumable(context.scene, objects, frame_range(characters[0])) is None:
            cls.poll_message_set("No bake was stopped")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        discard(context.scene, [obj.name for obj in selected_characters(context)])
        self.report({"INFO"}, "The next bake begins anew")
        return {"FINISHED"}
