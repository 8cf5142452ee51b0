# SPDX-License-Identifier: GPL-3.0-or-later
"""The heat map: what springs have learned, as a colour attribute in the viewport with a legend beside it."""

import bpy
import numpy as np
from bpy.props import EnumProperty
from bpy.types import Operator

from followthrough.blender import has_learned, read_learned
from followthrough.blender.modes import object_mode
from followthrough.spring_heat_map import HeatMap, Quantity, heat_map

from ..bake.session import idle
from ..characters import active_character, why_not_editable
from . import legend

ATTRIBUTE = "Followthrough Heat Map"
#: Property of the mesh: what its heat map shows.
_SHOWN = "followthrough_heat_map"
#: Property of the screen: what the viewports coloured before.
_BEFORE = "followthrough_color_type"
_ITEMS = (
    ("stiffness", "Stiffness", "How stiff springs are: log ks"),
    ("damping", "Damping", "How strongly they are damped: log kd"),
    ("regime", "Regime", "Whether they swing (blue) or creep (red): kd² - 4 ks"),
)


def is_shown(obj: bpy.types.Object) -> bool:
    """Whether this object's mesh has a heat map now."""
    return ATTRIBUTE in obj.data.color_attributes


def shown_quantity(obj: bpy.types.Object) -> str:
    """What it shows, or an empty string."""
    return str(obj.data.get(_SHOWN, "")) if is_shown(obj) else ""


def show(obj: bpy.types.Object, quantity: Quantity) -> HeatMap:
    """Colour the mesh by what its springs have learned.

    Raises
    ------
    ValueError
        Where nothing was learned.
    """
    learned = read_learned(obj)
    if learned is None:
        raise ValueError(f"Object '{obj.name}' has no learned springs: learn them from a simulation first")
    shown = heat_map(quantity, learned.stiffness, learned.damping, learned.known)
    colours = np.column_stack([shown.colours(), np.ones(len(learned.stiffness))])
    with object_mode(obj.name):
        attributes = obj.data.color_attributes
        attribute = attributes.get(ATTRIBUTE) or attributes.new(ATTRIBUTE, "BYTE_COLOR", "POINT")
        attribute.data.foreach_set("color_srgb", colours.astype(np.float32).ravel())
        attributes.active_color = attribute
        obj.data.update()
    obj.data[_SHOWN] = quantity
    legend.put(obj.name, shown)
    return shown


def hide(obj: bpy.types.Object) -> None:
    """Take the colours off again."""
    legend.take_off(obj.name)
    with object_mode(obj.name):
        attribute = obj.data.color_attributes.get(ATTRIBUTE)
        if attribute is not None:
            obj.data.color_attributes.remove(attribute)
    if _SHOWN in obj.data:
        del obj.data[_SHOWN]


def _colour_viewports(context: bpy.types.Context) -> None:
    for space in _viewports(context):
        if space.shading.color_type != "VERTEX":
            context.screen[_BEFORE] = space.shading.color_type
            space.shading.color_type = "VERTEX"


def _restore_viewports(context: bpy.types.Context) -> None:
    before = context.screen.get(_BEFORE) if context.screen is not None else None
    if before is None:
        return
    for space in _viewports(context):
        if space.shading.color_type == "VERTEX":
            space.shading.color_type = before
    del context.screen[_BEFORE]


def _viewports(context: bpy.types.Context) -> list[bpy.types.SpaceView3D]:
    areas = context.screen.areas if context.screen is not None else ()
    return [area.spaces.active for area in areas if area.type == "VIEW_3D"]


class FOLLOWTHROUGH_OT_show_heat_map(Operator):
    bl_idname = "followthrough.show_heat_map"
    bl_label = "Show Heat Map"
    bl_options = {"REGISTER", "UNDO"}

    quantity: EnumProperty(  # type: ignore[valid-type]
        name="Quantity",
        description="What the colours stand for",
        items=_ITEMS,
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        meanings = {key: meaning for key, _, meaning in _ITEMS}
        return f"Colour the character by its learned springs. {meanings[properties.quantity]}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None or not has_learned(obj):
            cls.poll_message_set("Learn from a simulation first")
            return False
        if reason := why_not_editable(obj):
            cls.poll_message_set(reason)
            return False
        return idle(cls)

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        try:
            show(obj, self.quantity)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        _colour_viewports(context)
        return {"FINISHED"}


class FOLLOWTHROUGH_OT_hide_heat_map(Operator):
    bl_idname = "followthrough.hide_heat_map"
    bl_label = "Hide Heat Map"
    bl_description = "Take the heat map's colours off the character, and colour the viewport as before"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None or not is_shown(obj):
            return False
        if reason := why_not_editable(obj):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        hide(active_character(context))
        _restore_viewports(context)
        return {"FINISHED"}
