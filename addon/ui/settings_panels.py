# SPDX-License-Identifier: GPL-3.0-or-later
"""The sub-panels of a character: what is painted, how it moves, which frames, how the volume is made."""

import bpy
from bpy.types import Panel

from ..bake.session import running
from ..characters import active_character, missing_groups
from ..painting.paint import (
    MEANINGS,
    FOLLOWTHROUGH_OT_finish_painting,
    FOLLOWTHROUGH_OT_paint,
    brush_weight_owner,
    painted_target,
)
from ..painting.pin_groups import FOLLOWTHROUGH_OT_add_pin_group, FOLLOWTHROUGH_OT_remove_pin_group
from .lists import FOLLOWTHROUGH_UL_pin_groups
from .main_panel import FollowthroughPanel, draw_text
from .menus import FOLLOWTHROUGH_MT_presets

_PAINT_BUTTONS = (("STIFFNESS", "Stiffness"), ("MASS", "Mass"), ("PINS", "Pins"))


class CharacterPanel(FollowthroughPanel):
    """A sub-panel that is there for characters only, and out of reach while a bake runs."""

    bl_parent_id = "FOLLOWTHROUGH_PT_main"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_character(context) is not None

    def character_layout(self, context: bpy.types.Context) -> tuple[bpy.types.UILayout, bpy.types.Object]:
        layout: bpy.types.UILayout = self.layout  # type: ignore[attr-defined]
        layout.use_property_split = True
        layout.use_property_decorate = False
        layout.enabled = running() is None
        return layout, active_character(context)


class FOLLOWTHROUGH_PT_paint(CharacterPanel, Panel):
    bl_label = "Paint"

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.character_layout(context)
        target = painted_target(obj)
        row = layout.row(align=True)
        for key, label in _PAINT_BUTTONS:
            row.operator(FOLLOWTHROUGH_OT_paint.bl_idname, text=label, depress=key == target).target = key
        if target is not None:
            column = layout.column(align=True)
            column.label(text=MEANINGS[target], icon="INFO")
            if (owner := brush_weight_owner(context)) is not None:
                column.prop(owner, "weight", slider=True)
        for name in missing_groups(obj):
            text = f"No vertex group '{name}': what is suggested is baked. Its button makes it again"
            draw_text(layout, context, text, icon="ERROR")
        if obj.mode == "WEIGHT_PAINT":
            layout.operator(FOLLOWTHROUGH_OT_finish_painting.bl_idname, icon="CHECKMARK")
        self._draw_pin_groups(layout, obj)

    def _draw_pin_groups(self, layout: bpy.types.UILayout, obj: bpy.types.Object) -> None:
        settings = obj.followthrough
        layout.label(text="Pin Groups")
        row = layout.row()
        row.template_list(
            FOLLOWTHROUGH_UL_pin_groups.__name__, "", settings, "pin_groups", settings, "active_pin_group", rows=2
        )
        buttons = row.column(align=True)
        buttons.operator(FOLLOWTHROUGH_OT_add_pin_group.bl_idname, text="", icon="ADD")
        buttons.operator(FOLLOWTHROUGH_OT_remove_pin_group.bl_idname, text="", icon="REMOVE")
        if settings.active_pin_group < len(settings.pin_groups):
            pin = settings.pin_groups[settings.active_pin_group]
            layout.prop_search(pin, "name", obj, "vertex_groups", text="")


class FOLLOWTHROUGH_PT_motion(CharacterPanel, Panel):
    bl_label = "Motion"

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.character_layout(context)
        settings = obj.followthrough
        row = layout.row()
        row.use_property_split = False  # beside a label, a narrow sidebar would cut the names short
        row.prop(settings, "solver", expand=True)
        layout.menu(FOLLOWTHROUGH_MT_presets.__name__, icon="PRESET")
        simulated = settings.solver != "springs"
        column = layout.column(align=True)
        for name in ("modulus_soft", "modulus_stiff") if simulated else ("frequency_soft", "frequency_stiff"):
            column.prop(settings, name)
        layout.prop(settings, "simulation_damping" if simulated else "damping_ratio")
        layout.prop(settings, "gravity")
        layout.prop(settings, "amplitude")
        if settings.solver == "implicit-euler":
            layout.prop(settings, "quality")
        elif settings.solver == "emulator":
            layout.prop(settings, "corrections")
            layout.prop(settings, "weights")


class FOLLOWTHROUGH_PT_frames(CharacterPanel, Panel):
    bl_label = "Frames"

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.character_layout(context)
        settings = obj.followthrough
        layout.row().prop(settings, "frame_range", text="Range", expand=True)
        if settings.frame_range == "CUSTOM":
            column = layout.column(align=True)
            column.prop(settings, "frame_start", text="First")
            column.prop(settings, "frame_end", text="Last")
        layout.prop(settings, "use_loop")
        if settings.use_loop:
            layout.prop(settings, "cycles")
        else:
            layout.prop(settings, "preroll")
        layout.prop(settings, "output")


class FOLLOWTHROUGH_PT_volume(CharacterPanel, Panel):
    bl_label = "Volume"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.character_layout(context)
        settings = obj.followthrough
        layout.prop(settings, "cells")
        layout.prop(settings, "use_split_parts")
