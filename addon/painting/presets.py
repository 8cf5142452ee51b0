# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting values for the springs of usual body parts."""

from dataclasses import dataclass

import bpy
from bpy.props import EnumProperty
from bpy.types import Operator

from ..characters import active_character


@dataclass(frozen=True)
class Preset:
    """Frequencies (Hz) where stiffness is painted 0 and 1, and the damping ratio."""

    label: str
    description: str
    frequency_soft: float
    frequency_stiff: float
    damping_ratio: float


PRESETS = {
    "BELLY": Preset("Belly", "Heavy and slow, swings a few times", 3.0, 9.0, 0.25),
    "EARS": Preset("Ears", "Light and floppy, swings on for long", 2.6, 10.0, 0.15),
    "TAIL": Preset("Tail", "Trails far behind and swings out slowly", 2.4, 8.0, 0.2),
    "JOWLS": Preset("Jowls", "Loose skin, shakes fast and soon settles", 4.5, 13.0, 0.3),
    "MUSCLE": Preset("Muscle", "Firm flesh, a short jiggle on impact", 7.0, 18.0, 0.4),
}


class FOLLOWTHROUGH_OT_apply_preset(Operator):
    bl_idname = "followthrough.apply_preset"
    bl_label = "Apply Motion Preset"
    bl_options = {"REGISTER", "UNDO"}

    preset: EnumProperty(  # type: ignore[valid-type]
        name="Preset",
        description="Body part whose motion is taken as a start",
        items=tuple((key, preset.label, preset.description) for key, preset in PRESETS.items()),
        options={"SKIP_SAVE"},
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        preset = PRESETS[properties.preset]
        frequencies = f"{preset.frequency_soft:g} to {preset.frequency_stiff:g} Hz"
        return f"{preset.description}: {frequencies}, damping {preset.damping_ratio:g}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return active_character(context) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        if obj is None:
            return {"CANCELLED"}
        preset, settings = PRESETS[self.preset], obj.followthrough
        # The softest first down, then the stiffest: setting one keeps the other on its side.
        settings.frequency_soft = min(preset.frequency_soft, settings.frequency_stiff)
        settings.frequency_stiff = preset.frequency_stiff
        settings.frequency_soft = preset.frequency_soft
        settings.damping_ratio = preset.damping_ratio
        return {"FINISHED"}
