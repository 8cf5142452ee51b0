# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of one character, kept on its object and saved with the file."""

import math

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    StringProperty,
)
from bpy.types import PropertyGroup

from followthrough.settings import SpringSettings, VolumeSettings

_SPRINGS = SpringSettings()
_VOLUME = VolumeSettings()

#: Blender knows hertz since 4.5; before that the name says the unit.
_KNOWS_HERTZ = "FREQUENCY" in bpy.types.Property.bl_rna.properties["unit"].enum_items
_HERTZ = {"unit": "FREQUENCY"} if _KNOWS_HERTZ else {}


def _named_in_hertz(name: str) -> str:
    return name if _KNOWS_HERTZ else f"{name} (Hz)"


def frequency_from_stiffness(stiffness: float) -> float:
    """Hertz at which a spring of this stiffness (1/s²) swings."""
    return math.sqrt(stiffness) / (2.0 * math.pi)


def stiffness_from_frequency(frequency: float) -> float:
    """Spring stiffness (1/s²) that swings at this many hertz."""
    return (2.0 * math.pi * frequency) ** 2


def _raise_stiff_frequency(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
    if settings.frequency_stiff < settings.frequency_soft:
        settings.frequency_stiff = settings.frequency_soft


def _lower_soft_frequency(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
    if settings.frequency_soft > settings.frequency_stiff:
        settings.frequency_soft = settings.frequency_stiff


def _raise_last_frame(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
    if settings.frame_end < settings.frame_start:
        settings.frame_end = settings.frame_start


def _lower_first_frame(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
    if settings.frame_start > settings.frame_end:
        settings.frame_start = settings.frame_end


def _paint_active_pin_group(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
    """While a pin group is painted, choosing another one in the list goes on with that."""
    groups, painted = settings.id_data.vertex_groups, settings.id_data.vertex_groups.active
    if settings.id_data.mode != "WEIGHT_PAINT" or painted is None or painted.name not in settings.pin_groups:
        return
    if settings.active_pin_group < len(settings.pin_groups):
        chosen = groups.get(settings.pin_groups[settings.active_pin_group].name)
        if chosen is not None:
            groups.active = chosen


class FollowthroughPinGroup(PropertyGroup):
    """A vertex group that holds the character to its armature."""

    name: StringProperty(  # type: ignore[valid-type]
        name="Vertex Group",
        description="Vertex group whose weights pin the character to its armature",
    )
    strength: FloatProperty(  # type: ignore[valid-type]
        name="Strength",
        description="How firmly the group holds: at 1 painted skin follows the armature exactly, at 0 nothing is held",
        subtype="FACTOR",
        default=1.0,
        min=0.0,
        max=1.0,
    )


class FollowthroughSettings(PropertyGroup):
    """Secondary motion of one character."""

    is_added: BoolProperty(  # type: ignore[valid-type]
        name="Followthrough Added",
        description="This mesh is set up for secondary motion",
        options={"HIDDEN"},
    )

    pin_groups: CollectionProperty(type=FollowthroughPinGroup)  # type: ignore[valid-type]
    active_pin_group: IntProperty(  # type: ignore[valid-type]
        name="Active Pin Group",
        description="Pin group that is painted and edited",
        min=0,
        options={"HIDDEN"},
        update=_paint_active_pin_group,
    )

    frequency_soft: FloatProperty(  # type: ignore[valid-type]
        name=_named_in_hertz("Softest"),
        description="How fast skin swings where stiffness is painted 0; lower is softer and swings farther",
        default=frequency_from_stiffness(_SPRINGS.stiffness_range[0]),
        min=0.01,
        max=1000.0,
        soft_min=0.2,
        soft_max=20.0,
        step=10,
        precision=2,
        update=_raise_stiff_frequency,
        **_HERTZ,
    )
    frequency_stiff: FloatProperty(  # type: ignore[valid-type]
        name=_named_in_hertz("Stiffest"),
        description="How fast skin swings where stiffness is painted 1; higher is stiffer and swings less",
        default=frequency_from_stiffness(_SPRINGS.stiffness_range[1]),
        min=0.01,
        max=1000.0,
        soft_min=0.2,
        soft_max=20.0,
        step=10,
        precision=2,
        update=_lower_soft_frequency,
        **_HERTZ,
    )
    damping_ratio: FloatProperty(  # type: ignore[valid-type]
        name="Damping",
        description="How soon the swinging dies down: at 0 never, at 1 and more the skin settles without swinging",
        subtype="FACTOR",
        default=_SPRINGS.damping_ratio,
        min=0.0,
        soft_max=1.0,
        max=100.0,
        step=1,
        precision=2,
    )

    cells: IntProperty(  # type: ignore[valid-type]
        name="Cells",
        description=(
            "Cells of the simulated volume along the longest side of the character; "
            "more follow thin parts better and bake slower"
        ),
        default=_VOLUME.cells,
        min=1,
        max=1000,
        soft_min=8,
        soft_max=80,
    )
    use_split_parts: BoolProperty(  # type: ignore[valid-type]
        name="Split Parts",
        description="Keep parts of the body apart that merely come near each other, such as thighs, fingers and lips",
        default=_VOLUME.split_parts,
    )

    frame_range: EnumProperty(  # type: ignore[valid-type]
        name="Frames",
        description="Which frames are baked",
        items=(
            ("SCENE", "Scene", "Bake the frame range of the scene"),
            ("CUSTOM", "Custom", "Bake a frame range of its own"),
        ),
        default="SCENE",
    )
    frame_start: IntProperty(  # type: ignore[valid-type]
        name="First Frame",
        description="First frame that is baked",
        default=1,
        min=-1048574,
        max=1048574,
        update=_raise_last_frame,
    )
    frame_end: IntProperty(  # type: ignore[valid-type]
        name="Last Frame",
        description="Last frame that is baked",
        default=250,
        min=-1048574,
        max=1048574,
        update=_lower_first_frame,
    )
    preroll: IntProperty(  # type: ignore[valid-type]
        name="Pre-Roll",
        description="Frames that are simulated before the first one and not baked, so that the motion is under way",
        default=0,
        min=0,
        soft_max=100,
        max=10000,
    )
    use_loop: BoolProperty(  # type: ignore[valid-type]
        name="Loop",
        description="The frames are a cycle, such as a walk: its end leads into its start",
    )
    cycles: IntProperty(  # type: ignore[valid-type]
        name="Cycles",
        description="How often the cycle is simulated before it is baked; more close its seam better",
        default=2,
        min=1,
        soft_max=10,
        max=100,
    )
