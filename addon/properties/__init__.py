# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sets on a character, and how it becomes the library's settings."""

from .settings import FollowthroughPinGroup, FollowthroughSettings

classes: tuple[type, ...] = (FollowthroughPinGroup, FollowthroughSettings)

__all__ = ["FollowthroughPinGroup", "FollowthroughSettings", "classes"]
