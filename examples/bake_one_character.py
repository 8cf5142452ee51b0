# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake one character of a .blend file from a script: python bake_one_character.py IN.blend OBJECT OUT.blend."""

import sys

import bpy

from followthrough import blender
from followthrough.settings import Settings, SpringSettings

source, name, target = sys.argv[1:]
bpy.ops.wm.open_mainfile(filepath=source)
soft = Settings(solver="springs", springs=SpringSettings(stiffness_range=(100.0, 2000.0), damping_ratio=0.2))
bake = blender.Bake(bpy.context.scene, {name: blender.ObjectSettings(motion=soft)}, blender.FrameRange(preroll=12))
for progress in bake.run():
    print(f"frame {progress.frame}: {progress.done} of {progress.total}")
report = bake.finish()
print(f"moved at most {report.objects[0].largest_displacement:.3f} m")
bpy.ops.wm.save_as_mainfile(filepath=target)
