# SPDX-License-Identifier: GPL-3.0-or-later
"""Add Followthrough: the button that turns a skinned mesh into a character that can be painted and baked."""

import bpy
from bpy.types import Operator

from followthrough.blender import PINS_GROUP, add_groups, why_not_bakeable
from followthrough.settings import default_solver

from ..characters import active_mesh
from ..properties import overrides

#: Frames that springs are learned from, unless others are chosen.
LEARNED_FRAMES = 96


class FOLLOWTHROUGH_OT_add(Operator):
    bl_idname = "followthrough.add"
    bl_label = "Add Followthrough"
    bl_description = (
        "Create vertex groups for stiffness, mass and pins with suggested values: "
        "skin near the bones is pinned, and the rest is as stiff as it must be to swing about four times a second"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_mesh(context)
        if obj is None:
            cls.poll_message_set("Select a mesh first")
            return False
        return not obj.followthrough.is_added

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_mesh(context)
        if obj is None:
            return {"CANCELLED"}
        if reason := why_not_bakeable(obj, obj.followthrough.output):
            self.report({"ERROR"}, reason)
            return {"CANCELLED"}
        overrides.prepare(obj)
        previous = obj.vertex_groups.active
        previous_name = previous.name if previous is not None else ""
        try:
            created = add_groups(obj) if obj.data.library is None else []
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        settings = obj.followthrough
        settings.previous_group = previous_name
        for name in created:
            settings.made_groups.add().name = name
        if PINS_GROUP not in settings.pin_groups and PINS_GROUP in obj.vertex_groups:
            settings.pin_groups.add().name = PINS_GROUP
        settings.solver = default_solver()  # said, so that the file keeps it
        settings.frame_start, settings.frame_end = context.scene.frame_start, context.scene.frame_end
        settings.learn_start = context.scene.frame_start
        settings.learn_end = min(context.scene.frame_end, context.scene.frame_start + LEARNED_FRAMES - 1)
        settings.is_added = True
        if obj.data.library is not None:
            self.report(
                {"INFO"}, "The mesh is linked: it is baked as it is painted in its own file, or with suggested values"
            )
        else:
            self.report({"INFO"}, f"Created {', '.join(created)}" if created else "The mesh has its groups already")
        return {"FINISHED"}
