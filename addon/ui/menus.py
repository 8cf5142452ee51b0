# SPDX-License-Identifier: GPL-3.0-or-later
"""The menu of motion presets."""

import bpy
from bpy.types import Menu

from ..painting.presets import PRESETS, FOLLOWTHROUGH_OT_apply_preset


class FOLLOWTHROUGH_MT_presets(Menu):
    bl_label = "Motion Presets"
    bl_description = "Start from the motion of a usual body part"

    def draw(self, _context: bpy.types.Context) -> None:
        for key, preset in PRESETS.items():
            self.layout.operator(FOLLOWTHROUGH_OT_apply_preset.bl_idname, text=preset.label).preset = key
