# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of one character, kept on its object and saved with the file."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import bpy
from bpy.types import PropertyGroup

from followthrough.settings import EmulatorSettings, SimulationSettings, SpringSettings, VolumeSettings

#: Of all properties: a library override of a character keeps what is set on it.
OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty = (
    partial(prop, override=OVERRIDABLE)
    for prop in (
        bpy.props.BoolProperty,
        bpy.props.EnumProperty,
        bpy.props.FloatProperty,
        bpy.props.IntProperty,
        bpy.props.StringProperty,
    )
)
CollectionProperty = partial(bpy.props.CollectionProperty, override=OVERRIDABLE | {"USE_INSERTION"})

_SPRINGS = SpringSettings()
_VOLUME = VolumeSettings()

_SIMULATION = SimulationSettings()
_EMULATOR = EmulatorSettings()

#: Blender knows hertz since 4.5; before that the name says the unit.
_KNOWS_HERTZ = "FREQUENCY" in bpy.types.Property.bl_rna.properties["unit"].enum_items
#: So does it whether a path may start at the .blend file's folder.
_RELATIVE_PATHS = (
    {"PATH_SUPPORTS_BLEND_RELATIVE"}
    if "is_path_supports_blend_relative" in bpy.types.Property.bl_rna.properties
    else set()
)
#: From kilopascals to pascals.
KILO = 1000.0
#: Gravity on earth, m/s².
EARTH = 9.81

_Update = Callable[["FollowthroughSettings", bpy.types.Context], None]


def frequency_from_stiffness(stiffness: float) -> float:
    """Hertz at which a spring of this stiffness (1/s²) swings."""
    return math.sqrt(stiffness) / (2.0 * math.pi)


def stiffness_from_frequency(frequency: float) -> float:
    """Spring stiffness (1/s²) that swings at this many hertz."""
    return (2.0 * math.pi * frequency) ** 2


def _kept_in_order(low: str, high: str) -> tuple[_Update, _Update]:
    """Updates of two properties of which one may not pass the other: the one that is set takes the other along."""

    def raise_high(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
        if getattr(settings, high) < getattr(settings, low):
            setattr(settings, high, getattr(settings, low))

    def lower_low(settings: "FollowthroughSettings", _context: bpy.types.Context) -> None:
        if getattr(settings, low) > getattr(settings, high):
            setattr(settings, low, getattr(settings, high))

    return raise_high, lower_low


_raise_stiff_frequency, _lower_soft_frequency = _kept_in_order("frequency_soft", "frequency_stiff")
_raise_stiff_modulus, _lower_soft_modulus = _kept_in_order("modulus_soft", "modulus_stiff")
_raise_last_frame, _lower_first_frame = _kept_in_order("frame_start", "frame_end")
_raise_last_learned, _lower_first_learned = _kept_in_order("learn_start", "learn_end")


def _frequency(name: str, description: str, stiffness: float, update: _Update) -> Any:
    """A frequency in hertz; its default is that of a spring stiffness."""
    unit = {"unit": "FREQUENCY"} if _KNOWS_HERTZ else {}
    return FloatProperty(
        name=name if _KNOWS_HERTZ else f"{name} (Hz)",
        description=description,
        default=frequency_from_stiffness(stiffness),
        min=0.01,
        max=1000.0,
        soft_min=0.2,
        soft_max=20.0,
        step=10,
        precision=2,
        update=update,
        **unit,
    )


def _modulus(name: str, description: str, pascals: float, update: _Update) -> Any:
    """Young's modulus in kilopascals, a unit that Blender does not know."""
    return FloatProperty(
        name=f"{name} (kPa)",
        description=f"{description}, in kilopascals of a character 1 m long; one of another size gets that of its size",
        default=pascals / KILO,
        min=0.01,
        max=1e6,
        soft_min=0.5,
        soft_max=1000.0,
        step=100,
        precision=2,
        update=update,
    )


def _damping(description: str, default: float) -> Any:
    return FloatProperty(
        name="Damping",
        description=description,
        subtype="FACTOR",
        default=default,
        min=0.0,
        soft_max=1.0,
        max=100.0,
        step=1,
        precision=2,
    )


def _scene_frame(name: str, description: str, default: int, update: _Update) -> Any:
    return IntProperty(name=name, description=description, default=default, min=-1048574, max=1048574, update=update)


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


class FollowthroughMadeGroup(PropertyGroup):
    """Name of a vertex group that the add-on made, and takes away again."""


class FollowthroughSettings(PropertyGroup):
    """Secondary motion of one character."""

    is_added: BoolProperty(  # type: ignore[valid-type]
        name="Followthrough Added",
        description="This mesh is set up for secondary motion",
        options={"HIDDEN"},
    )

    made_groups: CollectionProperty(type=FollowthroughMadeGroup)  # type: ignore[valid-type]
    previous_group: StringProperty(  # type: ignore[valid-type]
        name="Previous Group",
        description="Vertex group that was the active one before Followthrough was added",
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

    solver: EnumProperty(  # type: ignore[valid-type]
        name="Solver",
        description="What makes the flesh move",
        items=(
            # Files know them by number, and those of before the emulator left the default unsaid.
            ("springs", "Springs", "Every bit of flesh swings on a spring of its own: instant, always stable", 0),
            ("emulator", "Emulator", "A network that has learned the simulation: nearly its motion, in less time", 2),
            (
                "implicit-euler",
                "Simulation",
                "Elastic flesh that pulls on its neighbours and keeps its volume: slower",
                1,
            ),
        ),
        default="springs",
    )

    frequency_soft: _frequency(  # type: ignore[valid-type]
        "Softest",
        "How fast skin swings where stiffness is painted 0; lower is softer and swings farther",
        _SPRINGS.stiffness_range[0],
        _raise_stiff_frequency,
    )
    frequency_stiff: _frequency(  # type: ignore[valid-type]
        "Stiffest",
        "How fast skin swings where stiffness is painted 1; higher is stiffer and swings less",
        _SPRINGS.stiffness_range[1],
        _lower_soft_frequency,
    )
    damping_ratio: _damping(  # type: ignore[valid-type]
        "How soon the swinging dies down: at 0 never, at 1 and more the skin settles without swinging",
        _SPRINGS.damping_ratio,
    )

    modulus_soft: _modulus(  # type: ignore[valid-type]
        "Softest",
        "Stiffness of the flesh (Young's modulus) where stiffness is painted 0",
        _SIMULATION.youngs_modulus_range[0],
        _raise_stiff_modulus,
    )
    modulus_stiff: _modulus(  # type: ignore[valid-type]
        "Stiffest",
        "Stiffness of the flesh (Young's modulus) where stiffness is painted 1",
        _SIMULATION.youngs_modulus_range[1],
        _lower_soft_modulus,
    )
    simulation_damping: _damping(  # type: ignore[valid-type]
        "How much sooner the swinging dies down than it does by itself: fewer frames a second damp more already",
        _SIMULATION.damping_ratio,
    )
    gravity: FloatProperty(  # type: ignore[valid-type]
        name="Gravity",
        description=(
            "How strongly flesh is pulled down, 1 as on earth on a character 1 m long; characters are usually modelled "
            "with what gravity does to them, and need none"
        ),
        default=_SIMULATION.gravity / EARTH,
        min=-100.0,
        max=100.0,
        soft_min=0.0,
        soft_max=1.0,
        step=1,
        precision=2,
    )
    quality: EnumProperty(  # type: ignore[valid-type]
        name="Quality",
        description="How exactly every frame is solved",
        items=(
            ("preview", "Preview", "Fast, and slightly off where soft flesh turns very fast"),
            ("fine", "Fine", "As good as the eye can tell"),
            ("converged", "Converged", "Exact, several times slower"),
        ),
        default=_SIMULATION.quality,
    )

    corrections: IntProperty(  # type: ignore[valid-type]
        name="Corrections",
        description=(
            "How often the simulation improves each frame that the emulator has predicted, at most: more is more exact and slower"
        ),
        default=_EMULATOR.corrections,
        min=0,
        soft_max=3,
        max=100,
    )
    weights: StringProperty(  # type: ignore[valid-type]
        name="Weights",
        description="File of the emulator's trained weights; where it is empty, those that come with Followthrough",
        subtype="FILE_PATH",
        options=_RELATIVE_PATHS,
    )
    amplitude: FloatProperty(  # type: ignore[valid-type]
        name="Amplitude",
        description="How far the motion goes, at the same timing: 0 is the armature alone, 1 what the solver says",
        default=1.0,
        min=0.0,
        max=100.0,
        soft_max=2.0,
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

    output: EnumProperty(  # type: ignore[valid-type]
        name="Output",
        description="What is written",
        items=(
            ("keys", "Shape Keys", "A shape key a frame on the mesh; plays in any Blender without another file"),
            (
                "absolute",
                "Absolute Shape Keys",
                "Shape keys in a row that one curve, of the evaluation time, runs through; for a mesh without other shape keys",
            ),
            (
                "pc2",
                "Point Cache (PC2)",
                "A .pc2 file beside the .blend, and a Mesh Cache modifier that plays it. The mesh may be linked from another file",
            ),
        ),
        default="keys",
    )

    frame_range: EnumProperty(  # type: ignore[valid-type]
        name="Frames",
        description="Which frames are baked",
        items=(
            ("SCENE", "Scene", "Bake the frame range of the scene"),
            ("ACTION", "Action", "Bake the frames of the action that the armature plays"),
            ("CUSTOM", "Custom", "Bake a frame range of its own"),
        ),
        default="SCENE",
    )
    frame_start: _scene_frame(  # type: ignore[valid-type]
        "First Frame", "First frame that is baked", 1, _raise_last_frame
    )
    frame_end: _scene_frame(  # type: ignore[valid-type]
        "Last Frame", "Last frame that is baked", 250, _lower_first_frame
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

    learn_start: IntProperty(  # type: ignore[valid-type]
        name="First Frame",
        description="First frame that springs are learned from; the simulation starts at rest there",
        default=1,
        min=-1048574,
        max=1048574,
        update=_raise_last_learned,
    )
    learn_end: IntProperty(  # type: ignore[valid-type]
        name="Last Frame",
        description="Last frame that springs are learned from; a hundred lively frames are enough",
        default=96,
        min=-1048574,
        max=1048574,
        update=_lower_first_learned,
    )
    use_learned: BoolProperty(  # type: ignore[valid-type]
        name="Use Learned",
        description="Swing on the springs that were learned, where there are any; the frequencies, damping and paint scale them",
        default=True,
    )
