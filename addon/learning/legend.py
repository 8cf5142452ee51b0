# SPDX-License-Identifier: GPL-3.0-or-later
"""The heat map's legend: a bar of colours with numbers, drawn over the viewport while the character is active."""

from dataclasses import dataclass

import bpy
import numpy as np

from followthrough.spring_heat_map import HeatMap, palette

from ..characters import active_character

#: Of the bar, in pixels of a screen of usual resolution.
_WIDTH, _HEIGHT, _MARGIN, _STRIPES, _TEXT_SIZE = 16, 160, 24, 32, 12

_shown: dict[str, HeatMap] = {}
_handler: object | None = None


@dataclass(frozen=True)
class Stripe:
    """One colour of the bar: its lower left and upper right corner in pixels."""

    corners: tuple[float, float, float, float]
    colour: tuple[float, float, float, float]


def put(name: str, shown: HeatMap) -> None:
    """Draw the legend of this object's heat map from now on, while it is the active one."""
    global _handler
    _shown[name] = shown
    if _handler is None and not bpy.app.background:
        _handler = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def take_off(name: str) -> None:
    """No longer."""
    _shown.pop(name, None)
    if not _shown:
        stop_drawing()


def stop_drawing() -> None:
    """Take all legends off, as when the add-on is disabled."""
    global _handler
    _shown.clear()
    if _handler is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handler, "WINDOW")
        _handler = None


def stripes(shown: HeatMap, scale: float) -> list[Stripe]:
    """The bar's colours from its lower end to its upper one, where a screen has `scale` pixels for one."""
    colours = palette(shown.quantity, (np.arange(_STRIPES) + 0.5) / _STRIPES)
    height = _HEIGHT / _STRIPES
    return [
        Stripe(
            tuple(
                scale * value for value in (_MARGIN, _MARGIN + k * height, _MARGIN + _WIDTH, _MARGIN + (k + 1) * height)
            ),
            (*(float(channel) for channel in colour), 1.0),
        )
        for k, colour in enumerate(colours)
    ]


def labels(shown: HeatMap, scale: float) -> list[tuple[float, float, str]]:
    """Where which text stands: the ends, the middle, and above them what it is."""
    left = scale * (_MARGIN + _WIDTH + 6)
    marks = [(0.0, shown.low), (0.5, 0.5 * (shown.low + shown.high)), (1.0, shown.high)]
    placed = [(left, scale * (_MARGIN + share * (_HEIGHT - 8)), f"{value:.1f}") for share, value in marks]
    return [*placed, (scale * _MARGIN, scale * (_MARGIN + _HEIGHT + 10), shown.label)]


def _draw() -> None:
    context = bpy.context
    obj = active_character(context)
    shown = _shown.get(obj.name) if obj is not None else None
    if shown is None or not context.space_data.overlay.show_overlays:
        return
    import blf
    import gpu
    from gpu_extras.batch import batch_for_shader

    scale = context.preferences.system.ui_scale
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.bind()
    for stripe in stripes(shown, scale):
        left, low, right, high = stripe.corners
        points = [(left, low), (right, low), (right, high), (left, high)]
        shader.uniform_float("color", stripe.colour)
        batch_for_shader(shader, "TRIS", {"pos": points}, indices=[(0, 1, 2), (0, 2, 3)]).draw(shader)
    blf.size(0, scale * _TEXT_SIZE)
    blf.color(0, 1.0, 1.0, 1.0, 1.0)
    for x, y, text in labels(shown, scale):
        blf.position(0, x, y, 0)
        blf.draw(0, text)
