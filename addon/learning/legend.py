# SPDX-License-Identifier: GPL-3.0-or-later
"""The heat map's legend: a bar of colours with numbers, drawn over the viewport while the character is active."""

from dataclasses import dataclass

import bpy
import numpy as np

from followthrough.spring_heat_map import LABELS, palette

from ..characters import active_character
from .heat_map import Scale, shown_scale
from .viewports import shows_colours

#: Of the bar, in pixels of a screen of usual resolution. It stands above the panel of the last operation.
_WIDTH, _HEIGHT, _MARGIN, _BOTTOM, _STRIPES, _TEXT_SIZE = 16, 160, 24, 84, 32, 12

_handler: object | None = None


@dataclass(frozen=True)
class Stripe:
    """One colour of the bar: its lower left and upper right corner in pixels."""

    corners: tuple[float, float, float, float]
    colour: tuple[float, float, float, float]


def start_drawing() -> None:
    """Draw the legend of the active character's heat map from now on, wherever its colours are seen."""
    global _handler
    if _handler is None and not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def stop_drawing() -> None:
    """No longer, as when the add-on is disabled."""
    global _handler
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
        _handler = None


def legend_in(space: bpy.types.SpaceView3D, context: bpy.types.Context) -> Scale | None:
    """What the legend in a viewport says; None where none is to be seen, as the colours are not, or weights are painted there."""
    obj = active_character(context)
    if obj is None or obj.mode == "WEIGHT_PAINT" or not space.overlay.show_overlays or not shows_colours(space):
        return None
    return shown_scale(obj)


def stripes(shown: Scale, scale: float, left: float = 0.0) -> list[Stripe]:
    """The bar's colours from its lower end to its upper one.

    Parameters
    ----------
    shown
        What is drawn.
    scale
        Pixels of the screen for one.
    left
        Pixels that something else takes on the left.
    """
    colours = palette(shown.quantity, (np.arange(_STRIPES) + 0.5) / _STRIPES)
    height = _HEIGHT / _STRIPES
    low, high = left + scale * _MARGIN, left + scale * (_MARGIN + _WIDTH)
    return [
        Stripe(
            (low, scale * (_BOTTOM + k * height), high, scale * (_BOTTOM + (k + 1) * height)),
            (*(float(channel) for channel in colour), 1.0),
        )
        for k, colour in enumerate(colours)
    ]


def labels(shown: Scale, scale: float, left: float = 0.0) -> list[tuple[float, float, str]]:
    """Where which text stands: the ends, the middle, and above them what it is. Parameters as of `stripes`."""
    beside = left + scale * (_MARGIN + _WIDTH + 6)
    words = ("swings", "", "creeps") if shown.quantity == "regime" else ("", "", "")
    marks = zip((0.0, 0.5, 1.0), (shown.low, 0.5 * (shown.low + shown.high), shown.high), words, strict=True)
    placed = [
        (beside, scale * (_BOTTOM + share * (_HEIGHT - 8)), f"{value:.1f} {word}".strip())
        for share, value, word in marks
    ]
    title = f"{shown.quantity.title()}, {LABELS[shown.quantity]}"
    return [*placed, (left + scale * _MARGIN, scale * (_BOTTOM + _HEIGHT + 10), title)]


def _draw() -> None:
    context = bpy.context
    shown = legend_in(context.space_data, context)
    if shown is None:
        return
    import blf
    import gpu
    from gpu_extras.batch import batch_for_shader

    scale, left = context.preferences.system.ui_scale, _width_of_toolbar(context)
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.bind()
    for stripe in stripes(shown, scale, left):
        west, low, east, high = stripe.corners
        points = [(west, low), (east, low), (east, high), (west, high)]
        shader.uniform_float("color", stripe.colour)
        batch_for_shader(shader, "TRIS", {"pos": points}, indices=[(0, 1, 2), (0, 2, 3)]).draw(shader)
    blf.size(0, scale * _TEXT_SIZE)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    for x, y, text in labels(shown, scale, left):
        blf.position(0, x, y, 0)
        blf.draw(0, text)


def _width_of_toolbar(context: bpy.types.Context) -> float:
    """Pixels on the left that tools are drawn over."""
    if not context.preferences.system.use_region_overlap or not context.space_data.show_region_toolbar:
        return 0.0
    return float(max((region.width for region in context.area.regions if region.type == "TOOLS"), default=0))
