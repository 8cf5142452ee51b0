# SPDX-License-Identifier: GPL-3.0-or-later
"""The list of pin groups."""

import bpy
from bpy.types import UIList


class FOLLOWTHROUGH_UL_pin_groups(UIList):
    def draw_item(
        self,
        _context: bpy.types.Context,
        layout: bpy.types.UILayout,
        settings: bpy.types.PropertyGroup,
        pin: bpy.types.PropertyGroup,
        _icon: int,
        _active_data: bpy.types.PropertyGroup,
        _active_property: str,
        _index: int = 0,
        _flags: int = 0,
    ) -> None:
        there = pin.name in settings.id_data.vertex_groups
        # The prefix that our groups share would push out of a narrow sidebar what tells them apart.
        name = pin.name.removeprefix("Followthrough ") or "No group chosen"
        split = layout.split(factor=0.65)
        split.label(text=name, icon="GROUP_VERTEX" if there else "ERROR")
        split.prop(pin, "strength", text="", emboss=False)
