# SPDX-License-Identifier: GPL-3.0-or-later
"""The Followthrough tab in the sidebar of the 3D viewport."""

from .learning_panel import FOLLOWTHROUGH_PT_learning
from .lists import FOLLOWTHROUGH_UL_pin_groups
from .main_panel import FOLLOWTHROUGH_PT_main
from .menus import FOLLOWTHROUGH_MT_presets
from .settings_panels import (
    FOLLOWTHROUGH_PT_frames,
    FOLLOWTHROUGH_PT_motion,
    FOLLOWTHROUGH_PT_paint,
    FOLLOWTHROUGH_PT_volume,
)

classes: tuple[type, ...] = (
    FOLLOWTHROUGH_UL_pin_groups,
    FOLLOWTHROUGH_MT_presets,
    FOLLOWTHROUGH_PT_main,
    FOLLOWTHROUGH_PT_paint,
    FOLLOWTHROUGH_PT_motion,
    FOLLOWTHROUGH_PT_learning,
    FOLLOWTHROUGH_PT_frames,
    FOLLOWTHROUGH_PT_volume,
)

__all__ = ["classes"]
