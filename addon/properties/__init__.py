# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sets on a character, and how it becomes the library's settings."""

from . import overrides
from .settings import OVERRIDABLE, FollowthroughMadeGroup, FollowthroughPinGroup, FollowthroughSettings

classes: tuple[type, ...] = (FollowthroughMadeGroup, FollowthroughPinGroup, FollowthroughSettings)

__all__ = [
    "OVERRIDABLE",
    "FollowthroughMadeGroup",
    "FollowthroughPinGroup",
    "FollowthroughSettings",
    "classes",
    "overrides",
]
