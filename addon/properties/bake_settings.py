# SPDX-License-Identifier: GPL-3.0-or-later
"""From what the artist set to what the library's bake takes."""

import bpy

from followthrough.blender import FrameRange, ObjectSettings, PaintGroups, PinGroup
from followthrough.settings import Settings, SimulationSettings, SpringSettings, VolumeSettings

from .settings import EARTH, KILO, stiffness_from_frequency


def object_settings(obj: bpy.types.Object) -> ObjectSettings:
    """How this object is baked.

    Raises
    ------
    ValueError
        Where a setting does not fit.
    """
    settings = obj.followthrough
    return ObjectSettings(
        motion=Settings(
            volume=VolumeSettings(cells=settings.cells, split_parts=settings.use_split_parts),
            solver=settings.solver,
            springs=SpringSettings(
                stiffness_range=(
                    stiffness_from_frequency(settings.frequency_soft),
                    stiffness_from_frequency(settings.frequency_stiff),
                ),
                damping_ratio=settings.damping_ratio,
            ),
            simulation=SimulationSettings(
                youngs_modulus_range=(KILO * settings.modulus_soft, KILO * settings.modulus_stiff),
                damping_ratio=settings.simulation_damping,
                gravity=EARTH * settings.gravity,
                quality=settings.quality,
            ),
        ),
        groups=PaintGroups(pins=tuple(PinGroup(pin.name, pin.strength) for pin in settings.pin_groups)),
    )


def frame_range(obj: bpy.types.Object) -> FrameRange:
    """Which frames are baked when this object is the active one."""
    settings = obj.followthrough
    custom = settings.frame_range == "CUSTOM"
    return FrameRange(
        start=settings.frame_start if custom else None,
        end=settings.frame_end if custom else None,
        # A loop begins in its own last cycle, not before its first frame.
        preroll=0 if settings.use_loop else settings.preroll,
        cycles=settings.cycles if settings.use_loop else 0,
    )
