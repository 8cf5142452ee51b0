# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sets on a character, and how it becomes the library's settings."""

from .settings import FollowthroughMadeGroup, FollowthroughPinGroup, FollowthroughSettings

classes: tuple[type, ...] = (FollowthroughMadeGroup, FollowthroughPinGroup, FollowthroughSettings)

__all__ = ["FollowthroughMadeGroup", "FollowthroughPinGroup", "FollowthroughSettings", "classes"]
