# SPDX-License-Identifier: GPL-3.0-or-later
"""One click into weight paint on the right vertex group, from any mode, and out again."""

import bpy
from bpy.props import EnumProperty, StringProperty
from bpy.types import Operator

from followthrough.blender import MASS_GROUP, STIFFNESS_GROUP, add_groups

from ..characters import active_character, missing_groups, why_not_editable, why_not_pinned

#: What each target means at its ends, for the panel and the tooltips.
MEANINGS = {
    "STIFFNESS": "0 soft, 1 stiff",
    "MASS": "0 light, 0.5 neutral, 1 heavy",
    "PINS": "0 free, 1 held by the armature",
}


#: What the tooltips say before that. Operators do not find their own properties' texts while a tooltip is made.
TARGETS = {
    "STIFFNESS": "Paint where the character is soft and where it is stiff",
    "MASS": "Paint where the character is light and where it is heavy",
    "PINS": "Paint where the character follows its armature",
}


def group_to_paint(obj: bpy.types.Object, target: str) -> str | None:
    """Name of the vertex group behind a target; None where no pin group is chosen."""
    if target == "STIFFNESS":
        return STIFFNESS_GROUP
    if target == "MASS":
        return MASS_GROUP
    settings = obj.followthrough
    if not 0 <= settings.active_pin_group < len(settings.pin_groups):
        return None
    name: str = settings.pin_groups[settings.active_pin_group].name
    return name


def painted_target(obj: bpy.types.Object) -> str | None:
    """Which target is being painted now."""
    active = obj.vertex_groups.active
    if obj.mode != "WEIGHT_PAINT" or active is None:
        return None
    return next((target for target in MEANINGS if group_to_paint(obj, target) == active.name), None)


def brush_weight_owner(context: bpy.types.Context) -> bpy.types.bpy_struct | None:
    """What holds the weight that is painted: all brushes together or the one in use; None while there is no brush."""
    tools = context.tool_settings
    paint = tools.weight_paint
    if paint is None or paint.brush is None:
        return None
    # Blender 5.0 moved what brushes share from the tools to each paint mode.
    shared = getattr(paint, "unified_paint_settings", None) or tools.unified_paint_settings
    return shared if shared.use_unified_weight else paint.brush


class FOLLOWTHROUGH_OT_paint(Operator):
    bl_idname = "followthrough.paint"
    bl_label = "Paint Followthrough"
    bl_options = {"REGISTER", "UNDO"}

    target: EnumProperty(  # type: ignore[valid-type]
        name="Paint",
        description="What is painted",
        items=tuple((key, key.title(), description) for key, description in TARGETS.items()),
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return f"{TARGETS[properties.target]}: {MEANINGS[properties.target]}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None:
            cls.poll_message_set("Add Followthrough to a mesh first")
            return False
        if not obj.visible_get():
            cls.poll_message_set("Show the mesh first: a hidden one cannot be painted")
            return False
        if reason := why_not_editable(obj):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        name = group_to_paint(obj, self.target) if obj is not None else None
        if obj is None or name is None:
            self.report({"ERROR"}, "Add a pin group first")
            return {"CANCELLED"}
        if name in missing_groups(obj) and not self._make_again(obj, name):
            return {"CANCELLED"}
        if name not in obj.vertex_groups:
            self.report({"ERROR"}, why_not_pinned(obj) or f"The mesh has no vertex group '{name}'")
            return {"CANCELLED"}
        object_name = obj.name
        if obj.mode != "WEIGHT_PAINT":
            bpy.ops.object.mode_set(mode="WEIGHT_PAINT")
        # Entering the mode makes the group of the active bone the active one, so ours is chosen afterwards.
        obj = context.scene.objects[object_name]
        obj.vertex_groups.active = obj.vertex_groups[name]
        return {"FINISHED"}

    def _make_again(self, obj: bpy.types.Object, name: str) -> bool:
        """Make a group of stiffness or mass that was deleted or renamed, with suggested values."""
        try:
            add_groups(obj, names=(name,))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return False
        if name not in obj.followthrough.made_groups:
            obj.followthrough.made_groups.add().name = name
        self.report({"INFO"}, f"The mesh had no '{name}': made again with suggested values")
        return True


class FOLLOWTHROUGH_OT_finish_painting(Operator):
    bl_idname = "followthrough.finish_painting"
    bl_label = "Finish Painting"
    bl_description = "Leave weight paint"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and context.object.mode == "WEIGHT_PAINT"

    def execute(self, _context: bpy.types.Context) -> set[str]:
        bpy.ops.object.mode_set(mode="OBJECT")
        return {"FINISHED"}


class FOLLOWTHROUGH_OT_select_character(Operator):
    bl_idname = "followthrough.select_character"
    bl_label = "Select Character"
    bl_description = "Make this mesh the active object"
    bl_options = {"REGISTER", "UNDO"}

    name: StringProperty(name="Mesh", options={"SKIP_SAVE"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = context.scene.objects.get(self.name)
        if obj is None or not obj.visible_get():
            self.report({"ERROR"}, f"Found no visible object '{self.name}'")
            return {"CANCELLED"}
        if context.object is not None and context.object.mode != "OBJECT":
            bpy.ops.object.mode_set(mode="OBJECT")
        for other in context.selected_objects:
            other.select_set(False)
        obj = context.scene.objects[self.name]
        obj.select_set(True)
        context.view_layer.objects.active = obj
        return {"FINISHED"}
