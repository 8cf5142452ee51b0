# SPDX-License-Identifier: GPL-3.0-or-later
"""Live preview: the operator that switches it, and what follows the timeline meanwhile."""

from .live import end, register_handlers, running, unregister_handlers
from .operator import FOLLOWTHROUGH_OT_preview

classes: tuple[type, ...] = (FOLLOWTHROUGH_OT_preview,)

__all__ = ["classes", "end", "register_handlers", "running", "unregister_handlers"]
