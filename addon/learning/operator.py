# SPDX-License-Identifier: GPL-3.0-or-later
"""Learn from Simulation: simulates some frames as flesh, and gives the springs the constants that come closest to it."""

import bpy
from bpy.types import Operator

from followthrough.blender import FrameRange, Learning, LearningReport, why_not_bakeable
from followthrough.blender.learning import LEAST_FRAMES

from ..bake.operator import StepwiseOperator
from ..bake.session import BakeSession
from . import heat_map


class FOLLOWTHROUGH_OT_learn(StepwiseOperator, Operator):
    bl_idname = "followthrough.learn"
    bl_label = "Learn from Simulation"
    bl_description = (
        "Simulate these frames of the selected characters as elastic flesh, and give every vertex the spring that comes "
        "closest to it. The springs then bake any other motion in an instant"
    )
    bl_options = {"REGISTER", "UNDO"}

    doing = "Learning from Simulation"
    cancelled = "Learning cancelled, nothing was changed"

    @classmethod
    def _why_not(cls, character: bpy.types.Object) -> str | None:
        return why_not_bakeable(character)

    def _begin(self, context: bpy.types.Context) -> BakeSession:
        characters, settings = self._chosen(context)
        first, last = characters[0].followthrough.learn_start, characters[0].followthrough.learn_end
        if (count := last - first + 1) < LEAST_FRAMES:
            raise ValueError(
                f"{count} {'frame is' if count == 1 else 'frames are'} too few: take {LEAST_FRAMES} or more to learn from, First to Last"
            )
        return BakeSession(
            context.scene, settings, FrameRange(first, last), Learning, "Learning, step", "Keeping springs"
        )

    def _report(self, report: LearningReport, notes: tuple[str, ...]) -> None:
        for learned in report.objects:
            heat_map.refresh(bpy.data.objects[learned.name])
            left = learned.rmse / learned.reference_rmse if learned.reference_rmse else 0.0
            self.report(
                {"INFO"},
                f"{learned.name}: {learned.learned} of {learned.vertices} vertices have learned in {report.seconds:.1f} s; "
                f"{left:.0%} of the simulated motion is left as error",
            )
            if learned.unconverged:
                self.report(
                    {"WARNING"},
                    f"{learned.name}: {learned.unconverged} simulated frames have not converged, and were learned from all the same",
                )
            if not learned.learned:
                self.report(
                    {"WARNING"}, f"{learned.name}: nothing swings freely enough to learn from; look at its pins"
                )
