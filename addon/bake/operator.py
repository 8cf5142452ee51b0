# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake Followthrough: in a window a little at a time, so that Blender stays alive; from scripts all at once."""

import math
import time
from typing import Any

import bpy
from bpy.types import Operator

from followthrough.blender import BakeReport, ObjectSettings, why_not_bakeable

from ..characters import require_pinned, selected_characters
from ..preview import live
from ..properties.bake_settings import frame_range, object_settings
from ..redraw import redraw_sidebars
from .session import BakeSession, idle, running

_NONE_SELECTED = "Add Followthrough to a mesh first"
#: Seconds that are baked before the window may be drawn again: usually, and at most where drawing takes long.
TIME_SLICE = 0.1
LONGEST_TIME_SLICE = 0.4

#: What remains possible while a bake runs: looking from elsewhere. Anything else could change what is baked.
_VIEW_EVENTS = {"MIDDLEMOUSE", "MOUSEMOVE", "TRACKPADPAN", "TRACKPADZOOM", "MOUSEROTATE", "MOUSESMARTZOOM"}
_WHEEL_EVENTS = {"WHEELUPMOUSE", "WHEELDOWNMOUSE"}


class StepwiseOperator:
    """What bakes and what learns from a simulation have in common: stepping through frames, from scripts or in a window."""

    doing = "Baking Followthrough"
    cancelled = "Bake cancelled, nothing was changed"

    _bake: BakeSession | None = None
    _timer: bpy.types.Timer | None = None
    _slice_ended: float | None = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        characters = selected_characters(context)
        if not characters:
            cls.poll_message_set(_NONE_SELECTED)
            return False
        reason = cls._why_not(characters[0])
        if reason is not None:
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bake at once, for scripts and without a window."""
        try:
            live.end()
            bake = self._begin(context)
            bake.advance(math.inf)
            self._report(bake.finish(), bake.notes())
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        try:
            live.end()
            self._bake = self._begin(context)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        manager = context.window_manager
        self._timer = manager.event_timer_add(0.01, window=context.window)
        manager.modal_handler_add(self)
        context.workspace.status_text_set(f"{self.doing}    Esc: Cancel")
        redraw_sidebars()
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        bake = self._bake
        if bake is None or running() is not bake:
            # The add-on was disabled meanwhile, which cancelled the bake.
            self._leave(context)
            return {"CANCELLED"}
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            kept = f"; it can be resumed from frame {bake.saved_frame}" if bake.saved_frame is not None else ""
            self.report({"INFO"}, f"{self.cancelled}{kept}")
            return {"CANCELLED"}
        if event.type == "TIMER":
            return self._tick(context, bake)
        wheel_alone = event.type in _WHEEL_EVENTS and not (event.alt or event.ctrl)
        return {"PASS_THROUGH"} if wheel_alone or event.type in _VIEW_EVENTS else {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Also called by Blender itself, when another file is opened or the window is closed."""
        if self._bake is not None:
            self._bake.cancel()
        self._leave(context)

    def _tick(self, context: bpy.types.Context, bake: BakeSession) -> set[str]:
        try:
            if not bake.is_simulated:
                bake.advance(self._time_slice())
                self._slice_ended = time.monotonic()
                redraw_sidebars()
                return {"RUNNING_MODAL"}
            report = bake.finish()
        except ValueError as error:
            self._leave(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except BaseException:
            self._leave(context)
            raise
        self._leave(context)
        self._report(report, bake.notes())
        return {"FINISHED"}

    def _time_slice(self) -> float:
        """Bake for twice as long as Blender needed to draw, so that a heavy scene does not spend its time on that."""
        drawing = time.monotonic() - self._slice_ended if self._slice_ended is not None else 0.0
        return min(max(TIME_SLICE, 2.0 * drawing), LONGEST_TIME_SLICE)

    def _leave(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
        if context.workspace is not None:
            context.workspace.status_text_set(None)
        redraw_sidebars()

    @classmethod
    def _why_not(cls, character: bpy.types.Object) -> str | None:
        """Why this cannot be done with a character, None where it can."""
        raise NotImplementedError

    @staticmethod
    def _chosen(context: bpy.types.Context) -> tuple[list[bpy.types.Object], dict[str, ObjectSettings]]:
        """The selected characters, and their settings by name."""
        characters = selected_characters(context)
        if not characters:
            raise ValueError(_NONE_SELECTED)
        for obj in characters:
            require_pinned(obj)
        return characters, {obj.name: object_settings(obj) for obj in characters}

    def _begin(self, context: bpy.types.Context) -> BakeSession:
        raise NotImplementedError

    def _report(self, report: Any, notes: tuple[str, ...]) -> None:
        raise NotImplementedError


class FOLLOWTHROUGH_OT_bake(StepwiseOperator, Operator):
    bl_idname = "followthrough.bake"
    bl_label = "Bake Followthrough"
    bl_description = (
        "Simulate the secondary motion of the selected characters and write it to shape keys, one a frame, or a point cache. "
        "An earlier bake is replaced; other shape keys and animation are not touched"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def _why_not(cls, character: bpy.types.Object) -> str | None:
        return why_not_bakeable(character, character.followthrough.output)

    def _begin(self, context: bpy.types.Context) -> BakeSession:
        characters, settings = self._chosen(context)
        return BakeSession(context.scene, settings, frame_range(characters[0]))

    def _report(self, report: BakeReport, notes: tuple[str, ...]) -> None:
        frames = report.end - report.start + 1
        names = ", ".join(baked.name for baked in report.objects)
        count = f"{frames} {'frame' if frames == 1 else 'frames'}"
        # In one message, as a window shows the last one alone.
        self.report({"INFO"}, ". ".join([f"Baked {count} of {names} in {report.seconds:.1f} s", *notes]))
        for baked in report.objects:
            for warning in baked.warnings:
                self.report({"WARNING"}, warning)
