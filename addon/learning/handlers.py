# SPDX-License-Identifier: GPL-3.0-or-later
"""What the heat map does as long as the add-on is enabled: its legend, and viewports that follow undo."""

from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import heat_map, legend, viewports

_NAMES = ("undo_post", "redo_post")


@persistent
def _follow_undo(*_: Any) -> None:
    viewports.follow_undo(heat_map.is_any_shown())


def register_handlers() -> None:
    """Draw legends, and listen to undo."""
    legend.start_drawing()
    for name in _NAMES:
        getattr(bpy.app.handlers, name).append(_follow_undo)


def unregister_handlers() -> None:
    """No longer."""
    legend.stop_drawing()
    for name in _NAMES:
        handlers = getattr(bpy.app.handlers, name)
        if _follow_undo in handlers:
            handlers.remove(_follow_undo)
