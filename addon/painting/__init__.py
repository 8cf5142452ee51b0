# SPDX-License-Identifier: GPL-3.0-or-later
"""Setting a character up and painting it: the vertex groups, the way into and out of weight paint, presets."""

from .add import FOLLOWTHROUGH_OT_add
from .paint import FOLLOWTHROUGH_OT_finish_painting, FOLLOWTHROUGH_OT_paint, FOLLOWTHROUGH_OT_select_character
from .pin_groups import FOLLOWTHROUGH_OT_add_pin_group, FOLLOWTHROUGH_OT_remove_pin_group
from .presets import FOLLOWTHROUGH_OT_apply_preset
from .remove import FOLLOWTHROUGH_OT_remove

classes: tuple[type, ...] = (
    FOLLOWTHROUGH_OT_add,
    FOLLOWTHROUGH_OT_remove,
    FOLLOWTHROUGH_OT_select_character,
    FOLLOWTHROUGH_OT_paint,
    FOLLOWTHROUGH_OT_finish_painting,
    FOLLOWTHROUGH_OT_add_pin_group,
    FOLLOWTHROUGH_OT_remove_pin_group,
    FOLLOWTHROUGH_OT_apply_preset,
)

__all__ = ["classes"]
