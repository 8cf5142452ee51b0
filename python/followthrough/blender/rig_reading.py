# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes and armatures as the plain arrays of `followthrough.character`."""

from __future__ import annotations

import bpy

from followthrough.character import Surface


def read_surface(obj: bpy.types.Object) -> Surface:
    """Read a mesh object at rest, with its rig where a plain Armature modifier alone moves it.

    Raises
    ------
    NotBakeableError
        Where the object cannot be baked.
    """
    raise NotImplementedError
