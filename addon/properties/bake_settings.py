# SPDX-License-Identifier: GPL-3.0-or-later
"""From what the artist set to what the library's bake takes."""

import bpy

from followthrough.blender import FrameRange, ObjectSettings, PaintGroups, PinGroup, action_frames
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
                use_learned=settings.use_learned,
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
    """Which frames are baked when this object is the active one.

    Raises
    ------
    ValueError
        Where they are to be an action's, and there is none.
    """
    settings = obj.followthrough
    start, end = None, None
    if settings.frame_range == "CUSTOM":
        start, end = settings.frame_start, settings.frame_end
    elif settings.frame_range == "ACTION":
        frames = action_frames(obj, bpy.context.scene)
        if frames is None:
            raise ValueError(f"The armature of '{obj.name}' plays no action: choose another range")
        start, end = frames
    return FrameRange(
        start=start,
        end=end,
        # A loop begins in its own last cycle, not before its first frame.
        preroll=0 if settings.use_loop else settings.preroll,
        cycles=settings.cycles if settings.use_loop else 0,
    )
