# SPDX-License-Identifier: GPL-3.0-or-later
"""Springs that learn from the simulation, and the heat map that shows what they have learned."""

from .forget import FOLLOWTHROUGH_OT_forget_learned
from .handlers import register_handlers, unregister_handlers
from .heat_map import FOLLOWTHROUGH_OT_hide_heat_map, FOLLOWTHROUGH_OT_show_heat_map
from .operator import FOLLOWTHROUGH_OT_learn

classes: tuple[type, ...] = (
    FOLLOWTHROUGH_OT_learn,
    FOLLOWTHROUGH_OT_forget_learned,
    FOLLOWTHROUGH_OT_show_heat_map,
    FOLLOWTHROUGH_OT_hide_heat_map,
)

__all__ = ["classes", "register_handlers", "unregister_handlers"]
