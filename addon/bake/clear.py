# SPDX-License-Identifier: GPL-3.0-or-later
"""Clear: takes back exactly what a bake made."""

import bpy
from bpy.types import Operator

from followthrough.blender import baked_range, clear
from followthrough.blender.point_cache import our_modifier

from ..characters import selected_characters, why_not_settable
from ..preview import live
from .session import idle


def why_not_clearable(obj: bpy.types.Object) -> str | None:
    """Reason why the bake that this object plays cannot be taken off it; None where it can, or where there is none."""
    if baked_range(obj) is None:
        return None
    if obj.library is None and obj.data.library is not None and our_modifier(obj) is None:
        return (
            f"The bake of '{obj.name}' is on its mesh, which is linked from {obj.data.library.filepath}: clear it in that file, or "
            "make the mesh local (Object > Relations > Make Local)"
        )
    return why_not_settable(obj)


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
        for reason in filter(None, map(why_not_clearable, selected_characters(context))):
            cls.poll_message_set(reason)
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
