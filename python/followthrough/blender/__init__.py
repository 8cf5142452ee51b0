# SPDX-License-Identifier: GPL-3.0-or-later
"""Characters in Blender: read them, bake their secondary motion to shape keys, clear it again. Imports `bpy`; no UI.

The command line and the add-on both drive this::

    from followthrough import blender

    bake = blender.Bake(scene, {"Fox": blender.ObjectSettings()}, blender.FrameRange(start=1, end=48, preroll=10))
    for progress in bake.run():        # one frame a step; `bake.cancel()` between any two leaves nothing changed
        print(progress.done, progress.total)
    report = bake.finish()             # writes the shape keys

Messages of `NotBakeableError` and of every other `ValueError` are meant for the artist.
"""

from followthrough.blender.bake import Bake, FrameRange, ObjectSettings, Progress
from followthrough.blender.bake_cache import BakeCache, cache_folder, resumable_frame
from followthrough.blender.bake_report import BakeReport, ObjectReport
from followthrough.blender.cautions import caution_before_bake
from followthrough.blender.groups import (
    MASS_GROUP,
    PINS_GROUP,
    STIFFNESS_GROUP,
    PaintGroups,
    PinGroup,
    add_groups,
    read_paint,
    remove_groups,
    write_group,
)
from followthrough.blender.learned_springs import has_learned, read_learned, remove_learned
from followthrough.blender.learning import Learning, LearningReport, ObjectLearning
from followthrough.blender.outputs import OUTPUTS, OutputKind, baked_range, clear
from followthrough.blender.preview import Preview, why_not_previewable
from followthrough.blender.preview_key import remove_left_over
from followthrough.blender.rig_reading import read_surface
from followthrough.blender.scene import NotBakeableError, action_frames, skinned_meshes, why_not_bakeable

__all__ = [
    "MASS_GROUP",
    "OUTPUTS",
    "PINS_GROUP",
    "STIFFNESS_GROUP",
    "Bake",
    "BakeCache",
    "BakeReport",
    "FrameRange",
    "Learning",
    "LearningReport",
    "NotBakeableError",
    "ObjectLearning",
    "ObjectReport",
    "ObjectSettings",
    "OutputKind",
    "PaintGroups",
    "PinGroup",
    "Preview",
    "Progress",
    "action_frames",
    "add_groups",
    "baked_range",
    "cache_folder",
    "caution_before_bake",
    "clear",
    "has_learned",
    "read_learned",
    "read_paint",
    "read_surface",
    "remove_groups",
    "remove_learned",
    "remove_left_over",
    "resumable_frame",
    "skinned_meshes",
    "why_not_bakeable",
    "why_not_previewable",
    "write_group",
]
