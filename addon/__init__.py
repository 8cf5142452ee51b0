# SPDX-License-Identifier: GPL-3.0-or-later
"""Followthrough for Blender: paint where a character is soft, heavy or pinned, press Bake, get shape keys."""

from .registration import register, unregister

__all__ = ["register", "unregister"]
