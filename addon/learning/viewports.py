# SPDX-License-Identifier: GPL-3.0-or-later
"""Letting viewports show the colours of a mesh while there is a heat map, and what they showed before afterwards.

Screens take no part in undo, so a heat map that is undone is followed here.
"""

from collections.abc import Iterator

import bpy

#: Property of the screen: what its viewports showed before, by the number of their area.
_BEFORE = "followthrough_shading"

_taken_back_by_undo = False


def colour(context: bpy.types.Context) -> None:
    """Show the meshes' colours in all solid viewports of the screen; where there are none, in the one that is used."""
    spaces = dict(_viewports(context.screen))
    solid = {index: space for index, space in spaces.items() if space.shading.type == "SOLID"}
    if not solid:
        used = {index: space for index, space in spaces.items() if space == context.space_data}
        solid = used or dict(list(spaces.items())[:1])
    for index, space in solid.items():
        if not shows_colours(space):
            _remember(context.screen, index, space.shading)
            space.shading.type, space.shading.color_type = "SOLID", "VERTEX"


def restore() -> None:
    """Show what was shown before, where nobody has chosen something else since."""
    for screen in _screens():
        before = dict(screen.get(_BEFORE, {}))
        for index, space in _viewports(screen):
            if str(index) in before and shows_colours(space):
                space.shading.color_type, space.shading.type = before[str(index)]
        if _BEFORE in screen:
            del screen[_BEFORE]


def shows_colours(space: bpy.types.SpaceView3D) -> bool:
    """Whether a viewport shows the colours of meshes."""
    return space.shading.type == "SOLID" and space.shading.color_type == "VERTEX"


def follow_undo(is_any_shown: bool) -> None:
    """After undo or redo: a heat map may have gone, or come back.

    Parameters
    ----------
    is_any_shown
        Whether there is one now.
    """
    global _taken_back_by_undo
    if not is_any_shown and any(_BEFORE in screen for screen in _screens()):
        restore()
        _taken_back_by_undo = True
    elif is_any_shown and _taken_back_by_undo:
        colour(bpy.context)
        _taken_back_by_undo = False


def _remember(screen: bpy.types.Screen, index: int, shading: bpy.types.View3DShading) -> None:
    kept = dict(screen.get(_BEFORE, {}))
    kept[str(index)] = [shading.color_type, shading.type]
    screen[_BEFORE] = kept


def _screens() -> Iterator[bpy.types.Screen]:
    manager = bpy.context.window_manager
    for window in manager.windows if manager is not None else ():
        yield window.screen


def _viewports(screen: bpy.types.Screen | None) -> Iterator[tuple[int, bpy.types.SpaceView3D]]:
    for index, area in enumerate(screen.areas if screen is not None else ()):
        if area.type == "VIEW_3D":
            yield index, area.spaces.active
