# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake's solver is not made for, said before the bake."""

from __future__ import annotations

import bpy

from followthrough.blender.bake import ObjectSettings
from followthrough.blender.groups import read_paint
from followthrough.blender.rig_reading import read_surface
from followthrough.blender.scene import frame_time
from followthrough.blender.vertex_weights import read_weights
from followthrough.emulated_flesh import caution


def caution_before_bake(obj: bpy.types.Object, settings: ObjectSettings, scene: bpy.types.Scene) -> str:
    """A sentence for the artist where this object is more than its solver is made for, or an empty one.

    It reads what is painted but makes no volume, and says the same as `Bake.cautions`. An object in Edit or Sculpt Mode leaves it
    for a moment, which cannot be done while a panel is drawn.

    Raises
    ------
    NotBakeableError, ValueError
        Where the object cannot be baked, a group is missing, or the emulator has no weights.
    """
    if settings.motion.solver != "emulator":
        return ""
    weights = read_weights(obj)
    surface = read_surface(obj, weights)
    paint = read_paint(obj, surface, settings.groups, weights)
    return caution(surface, paint, settings.motion, frame_time(scene))
