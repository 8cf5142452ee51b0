# SPDX-License-Identifier: GPL-3.0-or-later
"""What a whole frame of a character takes with the shipped network, and its parts: posing, step, embedding, inverse skinning.

The whole is what preview and bake run, one native pass (`secondary_motion.SecondaryMotion.step`). The parts are timed one by one on
a second copy of the character that takes the same frames; the pass does the last two for each vertex at once, so they add up to more.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from followthrough import _core
from followthrough.benchmarking import dancer
from followthrough.benchmarking.measurement import Frames
from followthrough.benchmarking.methods import MethodUnavailableError
from followthrough.character import BonePose, Paint, Rig, Surface
from followthrough.emulator_weights import are_shipped
from followthrough.secondary_motion import SecondaryMotion
from followthrough.settings import Settings, VolumeSettings
from followthrough.skinning import inverse_skin
from followthrough.suggestions import pins_near_bones

#: Of the skin: 13,916 vertices.
SIDES = 124
#: Along the dancer: a volume of about 1,500 vertices.
CELLS = 22
#: That move a vertex of the skin.
BONES = 4
Result = TypeVar("Result")

#: Of a frame, in order.
PARTS = ("posing", "step", "embedding", "inverse skinning")


@dataclass(frozen=True)
class WholeFrame:
    """A frame's times, with a number of threads.

    Attributes
    ----------
    threads
        That it ran with.
    surface_vertices, volume_vertices, free_vertices
        Counts.
    frames
        Measured.
    ms_median, ms_low, ms_high
        Milliseconds of the whole: the median, and the 10th and 90th percentile.
    parts
        Milliseconds of each of `PARTS`, medians.
    """

    threads: int
    surface_vertices: int
    volume_vertices: int
    free_vertices: int
    frames: int
    ms_median: float
    ms_low: float
    ms_high: float
    parts: dict[str, float]


@dataclass
class _Lane:
    threads: int
    whole: SecondaryMotion
    parts: SecondaryMotion
    milliseconds: dict[str, list[float]] = field(default_factory=dict)

    def reset(self, pose: BonePose) -> None:
        _core.set_threads(self.threads)
        self.whole.reset(pose)
        self.parts.solver.reset(self.parts.volume.reference(pose))

    def step(self, pose: BonePose, ahead: BonePose) -> None:
        """A frame of both copies; posing is that of the pose ahead, as in the pass, which keeps it for the next frame."""
        _core.set_threads(self.threads)
        self._time("whole", lambda: self.whole.step(pose, ahead))
        motion = self.parts
        volume, rig = motion.volume, motion.volume.surface.rig
        assert rig is not None
        reference = volume.reference(pose)
        self._time("posing", lambda: volume.reference(ahead))
        dynamic = self._time("step", lambda: motion.solver.step(reference))
        displacements = self._time("embedding", lambda: volume.surface_displacements(dynamic, reference))
        self._time(
            "inverse skinning",
            lambda: inverse_skin(
                volume.surface.rest_positions, rig.bone_indices, rig.bone_weights, pose.bone_matrices, displacements
            ),
        )

    def _time(self, name: str, work: Callable[[], Result]) -> Result:
        begun = time.perf_counter()
        result = work()
        self.milliseconds.setdefault(name, []).append(1000 * (time.perf_counter() - begun))
        return result

    def result(self) -> WholeFrame:
        volume = self.whole.volume
        low, median, high = np.percentile(self.milliseconds["whole"], [10, 50, 90])
        return WholeFrame(
            threads=self.threads,
            surface_vertices=len(volume.surface.rest_positions),
            volume_vertices=len(volume.rest_positions),
            free_vertices=int(np.count_nonzero(~volume.pinned)),
            frames=len(self.milliseconds["whole"]),
            ms_median=float(median),
            ms_low=float(low),
            ms_high=float(high),
            parts={name: float(np.median(self.milliseconds[name])) for name in PARTS},
        )


def make_motion(sides: int = SIDES, cells: int = CELLS) -> SecondaryMotion:
    """The dancer as a rigged character of the softest flesh, moved by the shipped network.

    Raises
    ------
    MethodUnavailableError
        Where this version brings no weights.
    """
    if not are_shipped():
        raise MethodUnavailableError("this version brings no weights for it")
    skin = dancer.surface(sides)
    _, weights = dancer.bone_weights(skin.vertices)
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :BONES].astype(np.int32)
    kept = np.take_along_axis(weights, bones, axis=1)
    rig = Rig(bones, kept / kept.sum(axis=1, keepdims=True), dancer.segments())
    count = len(skin.vertices)
    surface = Surface(skin.vertices, skin.triangles, rig=rig)
    paint = Paint(stiffness=np.zeros(count), mass=np.full(count, 0.5), pins=pins_near_bones(surface))
    # The capsules cross each other: one body, not parts that come near each other.
    settings = Settings(solver="emulator", volume=VolumeSettings(cells=cells, split_parts=False))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return SecondaryMotion(surface, paint, settings, dancer.DT)


def measure_whole_frame(
    threads: list[int],
    frames: int,
    progress: Frames = lambda frames: frames,
    sides: int = SIDES,
    cells: int = CELLS,
) -> list[WholeFrame]:
    """Time so many frames of the dance with each number of threads, interleaved.

    Raises
    ------
    MethodUnavailableError
        As `make_motion`.
    """
    usual = _core.threads()
    poses = [BonePose(dancer.pose(frame), np.eye(4)) for frame in range(frames + 2)]
    try:
        lanes = [_Lane(number, make_motion(sides, cells), make_motion(sides, cells)) for number in threads]
        for lane in lanes:
            lane.reset(poses[0])
        for frame in progress(range(1, frames + 1)):
            first = frame % len(lanes)
            for lane in lanes[first:] + lanes[:first]:
                lane.step(poses[frame], poses[frame + 1])
    finally:
        _core.set_threads(usual)
    return [lane.result() for lane in lanes]
