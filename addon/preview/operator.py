# SPDX-License-Identifier: GPL-3.0-or-later
"""Preview: shows the motion while the timeline plays, without baking it."""

import bpy
from bpy.types import Operator

from followthrough.blender import why_not_previewable

from ..bake.session import idle
from ..characters import require_pinned, selected_characters
from ..properties.bake_settings import frame_range, object_settings
from . import live

#: Whether the timeline plays because the button has started it.
_started_playback = False


class FOLLOWTHROUGH_OT_preview(Operator):
    bl_idname = "followthrough.preview"
    bl_label = "Preview Followthrough"
    bl_description = (
        "Show the secondary motion of the selected characters while the timeline plays, without baking it; once more ends it. "
        "The motion begins anew where the timeline jumps. Nothing of it is saved, rendered or kept"
    )
    # No undo step of its own: it leaves no trace that could be undone.
    bl_options = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not idle(cls):
            return False
        if live.running() is not None:
            return True
        characters = selected_characters(context)
        if not characters:
            cls.poll_message_set("Add Followthrough to a mesh first")
            return False
        reason = why_not_previewable(characters[0])
        if reason is not None:
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Switch it on or off."""
        if live.running() is not None:
            live.end()
            return {"FINISHED"}
        characters = selected_characters(context)
        try:
            for obj in characters:
                require_pinned(obj)
            objects = {obj.name: object_settings(obj) for obj in characters}
            live.start(context.scene, objects, _loop(characters[0], context.scene) if characters else None)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        """The same from a button, which also starts the playback, and stops it where it has started it."""
        result = self.execute(context)
        if context.screen is not None:
            play_or_stop(context.screen)
        return result


def play_or_stop(screen: bpy.types.Screen) -> None:
    """Let the timeline play while there is a preview; afterwards it goes on playing where it did so before."""
    global _started_playback
    if live.running() is not None and not screen.is_animation_playing:
        bpy.ops.screen.animation_play()
        _started_playback = True
    elif live.running() is None and _started_playback:
        if screen.is_animation_playing:
            bpy.ops.screen.animation_cancel(restore_frame=False)
        _started_playback = False


def _loop(obj: bpy.types.Object, scene: bpy.types.Scene) -> tuple[int, int] | None:
    """First and last frame where the character's frames are a cycle."""
    return frame_range(obj).ends_in(scene) if obj.followthrough.use_loop else None
