# SPDX-License-Identifier: GPL-3.0-or-later
"""The heat map: what springs have learned, as a colour attribute in the viewport with a legend beside it."""

from dataclasses import dataclass

import bpy
import numpy as np
from bpy.props import EnumProperty
from bpy.types import Operator

from followthrough.blender import has_learned, read_learned
from followthrough.blender.modes import object_mode
from followthrough.spring_heat_map import HeatMap, Quantity, heat_map

from ..bake.session import idle
from ..characters import active_character, why_not_editable
from . import viewports

ATTRIBUTE = "Followthrough Heat Map"
#: Properties of the mesh: what its heat map shows, the ends of the scale, and which colours were the active ones before.
_SHOWN, _SCALE, _BEFORE = "followthrough_heat_map", "followthrough_heat_map_scale", "followthrough_heat_map_before"
_ITEMS = (
    ("stiffness", "Stiffness", "How stiff springs are: log ks"),
    ("damping", "Damping", "How strongly they are damped: log kd"),
    ("regime", "Regime", "Whether they swing (blue) or creep (red): kd² - 4 ks"),
)


@dataclass(frozen=True)
class Scale:
    """What the colours of a heat map stand for, and the ends of their scale."""

    quantity: Quantity
    low: float
    high: float


def is_shown(obj: bpy.types.Object) -> bool:
    """Whether this object's mesh has a heat map now."""
    return ATTRIBUTE in obj.data.color_attributes


def shown_quantity(obj: bpy.types.Object) -> str:
    """What it shows, or an empty string."""
    return str(obj.data.get(_SHOWN, "")) if is_shown(obj) else ""


def shown_scale(obj: bpy.types.Object) -> Scale | None:
    """Its scale; None where there is no heat map. It is kept on the mesh, so that it comes and goes with the colours."""
    quantity, ends = shown_quantity(obj), obj.data.get(_SCALE)
    return Scale(quantity, *map(float, ends)) if quantity and ends is not None else None


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
        if not is_shown(obj):
            obj.data[_BEFORE] = attributes.active_color.name if attributes.active_color is not None else ""
        attribute = attributes.get(ATTRIBUTE) or attributes.new(ATTRIBUTE, "BYTE_COLOR", "POINT")
        attribute.data.foreach_set("color_srgb", colours.astype(np.float32).ravel())
        attributes.active_color = attribute
        obj.data.update()
    obj.data[_SHOWN], obj.data[_SCALE] = quantity, [shown.low, shown.high]
    return shown


def refresh(obj: bpy.types.Object) -> None:
    """Where a heat map is shown, let it show what the springs have learned since."""
    if quantity := shown_quantity(obj):
        show(obj, quantity)


def hide(obj: bpy.types.Object) -> None:
    """Take the colours off again; those that were the active ones are it again."""
    with object_mode(obj.name):
        attributes = obj.data.color_attributes
        if is_shown(obj):
            was_active = attributes.active_color is not None and attributes.active_color.name == ATTRIBUTE
            attributes.remove(attributes[ATTRIBUTE])
            before = attributes.get(obj.data.get(_BEFORE, ""))
            if was_active and before is not None:
                attributes.active_color = before
    for name in (_SHOWN, _SCALE, _BEFORE):
        if name in obj.data:
            del obj.data[name]
    if not is_any_shown():
        viewports.restore()


def is_any_shown() -> bool:
    """Whether some object of the file has a heat map."""
    return any(is_shown(obj) for obj in bpy.data.objects if obj.type == "MESH")


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
        viewports.colour(context)
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
        return {"FINISHED"}
