# SPDX-License-Identifier: GPL-3.0-or-later
"""The sub-panel of springs that learn: which frames, Learn, and the heat map of what was learned."""

import bpy
from bpy.types import Panel

from followthrough.blender import has_learned

from ..learning import heat_map
from ..learning.forget import FOLLOWTHROUGH_OT_forget_learned
from ..learning.heat_map import FOLLOWTHROUGH_OT_hide_heat_map, FOLLOWTHROUGH_OT_show_heat_map
from ..learning.operator import FOLLOWTHROUGH_OT_learn
from .main_panel import draw_text
from .settings_panels import CharacterPanel

_QUANTITIES = (("stiffness", "Stiffness"), ("damping", "Damping"), ("regime", "Regime"))


class FOLLOWTHROUGH_PT_learning(CharacterPanel, Panel):
    bl_label = "Learned Springs"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, obj = self.character_layout(context)
        settings = obj.followthrough
        column = layout.column(align=True)
        column.prop(settings, "learn_start", text="First")
        column.prop(settings, "learn_end", text="Last")
        layout.operator(FOLLOWTHROUGH_OT_learn.bl_idname, icon="PHYSICS")
        if not has_learned(obj):
            return
        row = layout.row()
        row.prop(settings, "use_learned")
        row.operator(FOLLOWTHROUGH_OT_forget_learned.bl_idname, text="", icon="TRASH")
        if settings.solver != "springs":
            draw_text(layout, context, "Springs swing on what was learned: choose them under Motion", icon="INFO")
        layout.label(text="Heat Map")
        shown = heat_map.shown_quantity(obj)
        row = layout.row(align=True)
        for key, label in _QUANTITIES:
            row.operator(FOLLOWTHROUGH_OT_show_heat_map.bl_idname, text=label, depress=key == shown).quantity = key
        if shown:
            layout.operator(FOLLOWTHROUGH_OT_hide_heat_map.bl_idname, icon="X")
