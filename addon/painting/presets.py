# SPDX-License-Identifier: GPL-3.0-or-later
"""Starting values for usual body parts."""

from dataclasses import dataclass

import bpy
from bpy.props import EnumProperty
from bpy.types import Operator

from ..characters import active_character, why_not_settable


@dataclass(frozen=True)
class Preset:
    """Frequencies (Hz) where stiffness is painted 0 and 1, and the damping ratio; for the simulation Young's moduli (kPa).

    The moduli are those at which a layer of flesh, a tenth of the character thick, swings at these frequencies, rounded.
    """

    label: str
    description: str
    frequencies: tuple[float, float]
    damping_ratio: float
    moduli: tuple[float, float]
    simulation_damping: float = 0.0


PRESETS = {
    "BELLY": Preset("Belly", "Heavy and slow, swings a few times", (3.0, 9.0), 0.25, (4.0, 40.0)),
    "EARS": Preset("Ears", "Light and floppy, swings on for long", (2.6, 10.0), 0.15, (3.0, 45.0)),
    "TAIL": Preset("Tail", "Trails far behind and swings out slowly", (2.4, 8.0), 0.2, (2.5, 30.0)),
    "JOWLS": Preset("Jowls", "Loose skin, shakes fast and soon settles", (4.5, 13.0), 0.3, (9.0, 80.0), 0.05),
    "MUSCLE": Preset("Muscle", "Firm flesh, a short jiggle on impact", (7.0, 18.0), 0.4, (22.0, 150.0), 0.1),
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
        springs = "springs of {:g} to {:g} Hz, damping {:g}".format(*preset.frequencies, preset.damping_ratio)
        simulation = "simulation of {:g} to {:g} kPa, damping {:g}".format(*preset.moduli, preset.simulation_damping)
        return f"{preset.description}: {springs}; {simulation}"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        obj = active_character(context)
        if obj is None:
            return False
        if reason := why_not_settable(obj):
            cls.poll_message_set(reason)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        obj = active_character(context)
        if obj is None:
            return {"CANCELLED"}
        preset, settings = PRESETS[self.preset], obj.followthrough
        # Setting one may take the other along, so the second is set last and the first once more.
        settings.frequency_soft, settings.frequency_stiff = preset.frequencies
        settings.frequency_soft = preset.frequencies[0]
        settings.damping_ratio = preset.damping_ratio
        settings.modulus_soft, settings.modulus_stiff = preset.moduli
        settings.modulus_soft = preset.moduli[0]
        settings.simulation_damping = preset.simulation_damping
        return {"FINISHED"}
