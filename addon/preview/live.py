# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview that is running, if one is: it follows the timeline, and leaves no trace in files, undo steps and renders."""

import time
from collections.abc import Callable, Mapping
from typing import Any

import bpy
from bpy.app.handlers import persistent

from followthrough.blender import ObjectSettings, Preview, remove_left_over

from ..handlers import listen, listen_no_longer
from ..properties.bake_settings import object_settings
from ..redraw import redraw_sidebars

#: Seconds after which the panel shows new figures.
_FIGURES = 0.5

_running: Preview | None = None
_ended_because = ""
_drawn = 0.0


def running() -> Preview | None:
    """The preview under way."""
    return _running


def why_ended() -> str:
    """Why the last preview ended by itself; empty where it did not."""
    return _ended_because


def start(
    scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], loop: tuple[int, int] | None = None
) -> Preview:
    """Begin one, in the place of another.

    Raises
    ------
    ValueError
        Where it cannot be previewed, in words for the artist.
    """
    global _running
    end()
    preview = Preview(scene, objects, loop)
    try:
        preview.show(scene)
    except BaseException:
        preview.end()
        raise
    _running = preview
    listen(_FOLLOWING)
    return preview


def end(reason: str = "") -> None:
    """End it; everything is as it was before it."""
    global _running, _ended_because
    ended, _running, _ended_because = _running, None, reason
    listen_no_longer(_FOLLOWING)
    if ended is not None:
        ended.end()
        redraw_sidebars()


def figures(preview: Preview) -> str:
    """How fast it is, for the panel."""
    if not preview.frames_per_second:
        return "Play the timeline"
    return f"{preview.frames_per_second:.0f} frames a second, {preview.milliseconds:.1f} ms a frame"


def _follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """The timeline has moved."""
    global _drawn
    preview = _running
    if preview is None or (depsgraph is not None and depsgraph.mode == "RENDER"):
        return
    try:
        preview.show(scene, _settings(preview, scene))
    except (ValueError, ReferenceError) as problem:
        end(str(problem))
        return
    if time.monotonic() > _drawn + _FIGURES:
        _drawn = time.monotonic()
        redraw_sidebars()


#: Handlers that are there as long as a preview runs.
_FOLLOWING = {"frame_change_post": _follow}


def _settings(preview: Preview, scene: bpy.types.Scene) -> dict[str, ObjectSettings]:
    found = (scene.objects.get(name) for name in preview.object_names)
    return {obj.name: object_settings(obj) for obj in found if obj is not None and obj.followthrough.is_added}


def _tells(act: Callable[[Preview], None]) -> Callable[..., None]:
    """A handler that lets the preview that is running do something."""

    @persistent
    def handler(*_: Any) -> None:
        if _running is not None:
            act(_running)

    return handler


@persistent
def _leave_file(*_: Any) -> None:
    """Another file is opened: nothing of this one may be touched afterwards."""
    global _running, _ended_because
    _running, _ended_because = None, ""
    listen_no_longer(_FOLLOWING)


@persistent
def _clean(*_: Any) -> None:
    """Undo, or a file that was saved by itself, has brought back a preview that is over."""
    if _running is None:
        remove_left_over()


#: Handlers that are there as long as the add-on is, by the name of their list. Files are saved and pictures rendered without the preview.
_HANDLERS = {
    "save_pre": _tells(Preview.sleep),
    "save_post": _tells(Preview.wake),
    "save_post_fail": _tells(Preview.wake),
    "render_init": _tells(Preview.pause),
    "render_complete": _tells(Preview.unpause),
    "render_cancel": _tells(Preview.unpause),
    "load_pre": _leave_file,
    "load_post": _clean,
    "undo_post": _clean,
    "redo_post": _clean,
}


def register_handlers() -> None:
    """Listen to what happens to the file."""
    listen(_HANDLERS)


def unregister_handlers() -> None:
    """Listen no longer, and end the preview."""
    end()
    listen_no_longer(_HANDLERS)
