# SPDX-License-Identifier: GPL-3.0-or-later
"""From what the artist set to what the library's bake takes."""

from pathlib import Path

import bpy

from followthrough.blender import FrameRange, ObjectSettings, PaintGroups, PinGroup, action_frames
from followthrough.settings import EmulatorSettings, Settings, SimulationSettings, SpringSettings, VolumeSettings

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
                gravity=EARTH * settings.gravity,
                use_learned=settings.use_learned,
            ),
            simulation=SimulationSettings(
                youngs_modulus_range=(KILO * settings.modulus_soft, KILO * settings.modulus_stiff),
                damping_ratio=settings.simulation_damping,
                gravity=EARTH * settings.gravity,
                quality=settings.quality,
            ),
            emulator=EmulatorSettings(
                weights=Path(bpy.path.abspath(settings.weights)) if settings.weights else None,
                corrections=settings.corrections,
            ),
            amplitude=settings.amplitude,
        ),
        groups=PaintGroups(
            # A linked mesh is baked as it is painted in its own file.
            pins=None
            if obj.data.library is not None and not settings.pin_groups
            else tuple(PinGroup(pin.name, pin.strength) for pin in settings.pin_groups)
        ),
        output=settings.output,
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
