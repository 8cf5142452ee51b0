# SPDX-License-Identifier: GPL-3.0-or-later
"""Drawing what has changed without an event of its own."""

import bpy


def redraw_sidebars() -> None:
    """Let all 3D views draw their panels anew."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager is not None else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
