# SPDX-License-Identifier: GPL-3.0-or-later
"""What the chosen solver is not made for: said in the panel before a bake, with the way out a click away."""

import time
from dataclasses import dataclass
from typing import Any

import bpy
from bpy.types import Operator

from followthrough.blender import caution_before_bake

from ..characters import selected_characters
from ..properties.bake_settings import object_settings
from .session import idle

#: Paint is read again after this many times the time that reading took, so that drawing the panel stays quick.
_REST = 20.0


@dataclass(frozen=True)
class _Known:
    settings: Any
    text: str
    until: float


_known: dict[str, _Known] = {}


def caution_about(obj: bpy.types.Object, scene: bpy.types.Scene) -> str:
    """A sentence where this character is more than its solver is made for, or why that solver cannot be had; mostly empty.

    The panel asks at each redraw, so an answer is kept for a moment while the settings stay as they are.
    """
    if obj.followthrough.solver != "emulator":
        return ""
    unreadable = obj.mode in {"EDIT", "SCULPT"}  # without leaving them, which drawing must not
    began = time.monotonic()
    known = _known.get(obj.name)
    try:
        chosen = object_settings(obj)
    except ValueError as problem:
        return str(problem)
    settings = (chosen, scene.render.fps, scene.render.fps_base, len(obj.data.vertices))
    if known is not None and known.settings == settings and (unreadable or began < known.until):
        return known.text
    try:
        text = "" if unreadable else caution_before_bake(obj, chosen, scene)
    except ValueError as problem:
        text = str(problem)
    ended = time.monotonic()
    _known[obj.name] = _Known(settings, text, ended + _REST * (ended - began))
    return text


class FOLLOWTHROUGH_OT_use_simulation(Operator):
    bl_idname = "followthrough.use_simulation"
    bl_label = "Use Simulation"
    bl_description = (
        "Let the simulation move the selected characters instead of the emulator: slower, and good for any flesh"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return idle(cls) and any(obj.followthrough.solver == "emulator" for obj in selected_characters(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        for obj in selected_characters(context):
            if obj.followthrough.solver == "emulator" and caution_about(obj, context.scene):
                obj.followthrough.solver = "implicit-euler"
        return {"FINISHED"}
