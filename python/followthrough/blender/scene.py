# SPDX-License-Identifier: GPL-3.0-or-later
"""Which objects of a scene can carry secondary motion, and why another one cannot."""

from __future__ import annotations

import bpy


class NotBakeableError(ValueError):
    """An object that cannot be baked; the message says why and what to do."""


def skinned_meshes(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Mesh objects of the scene that an armature (or another deforming modifier) moves, in the scene's order."""
    raise NotImplementedError


def why_not_bakeable(obj: bpy.types.Object) -> str | None:
    """Reason why this object cannot be baked, a sentence for the artist; None where it can."""
    raise NotImplementedError
