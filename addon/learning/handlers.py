# SPDX-License-Identifier: GPL-3.0-or-later
"""What the heat map does as long as the add-on is enabled: its legend, and viewports that follow undo."""

from typing import Any

from bpy.app.handlers import persistent

from ..handlers import listen, listen_no_longer
from . import heat_map, legend, viewports


@persistent
def _follow_undo(*_: Any) -> None:
    viewports.follow_undo(heat_map.is_any_shown())


_HANDLERS = dict.fromkeys(("undo_post", "redo_post"), _follow_undo)


def register_handlers() -> None:
    """Draw legends, and listen to undo."""
    legend.start_drawing()
    listen(_HANDLERS)


def unregister_handlers() -> None:
    """No longer."""
    legend.stop_drawing()
    listen_no_longer(_HANDLERS)
