# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake, Discard and Clear: the operators, and the bake that is running."""

from .cautions import FOLLOWTHROUGH_OT_use_simulation
from .clear import FOLLOWTHROUGH_OT_clear
from .discard import FOLLOWTHROUGH_OT_discard_stopped_bake
from .operator import FOLLOWTHROUGH_OT_bake
from .session import running, stop

classes: tuple[type, ...] = (
    FOLLOWTHROUGH_OT_bake,
    FOLLOWTHROUGH_OT_discard_stopped_bake,
    FOLLOWTHROUGH_OT_clear,
    FOLLOWTHROUGH_OT_use_simulation,
)

__all__ = ["classes", "running", "stop"]
