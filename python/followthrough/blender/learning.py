# SPDX-License-Identifier: GPL-3.0-or-later
"""Learn springs from a simulation: steps through the frames as a bake does, fits at the end, and keeps the constants on the mesh."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough import mesh
from followthrough.blender import modes
from followthrough.blender.bake import Bake, FrameRange, ObjectSettings, Progress, _told_apart
from followthrough.blender.learned_springs import write_learned
from followthrough.blender.scene import NotBakeableError
from followthrough.blender.vertex_weights import VertexWeights
from followthrough.character import FloatArray, LearnedSprings, Paint, Pose, Surface
from followthrough.secondary_motion import painted_stiffness
from followthrough.settings import Settings
from followthrough.spring_fit import FitSettings, FitStatus, Fitting, SpringFit, Training, blocks_of
from followthrough.volume import Volume

#: Fewer frames tell too little of a swing.
LEAST_FRAMES = 10
#: ks, 1/s²: a third of a swing a second. What seems softer hardly came back while it was learned, and would drift in a longer shot.
LEAST_STIFFNESS = 4.0


@dataclass(frozen=True)
class ObjectLearning:
    """What was learned on one object.

    Attributes
    ----------
    vertices, learned : int
        Of the mesh, and how many of them have springs of their own now; the others keep their painted ones.
    rmse, reference_rmse : float
        Root mean square error of the springs, and of no springs at all, over learned vertices and frames, metres.
    unconverged : int
        Frames in which the simulation was not as exact as its quality promises.
    """

    name: str
    vertices: int
    learned: int
    rmse: float
    reference_rmse: float
    unconverged: int = 0


@dataclass(frozen=True)
class LearningReport:
    """What was learned, and how long it took."""

    objects: tuple[ObjectLearning, ...]
    start: int
    end: int
    seconds: float


@dataclass
class _Recording:
    """One object's motion, frame by frame, and the fit to it."""

    reference: list[FloatArray] = field(default_factory=list)
    displacements: list[FloatArray] = field(default_factory=list)
    fit: SpringFit | None = None
    painted: FloatArray | None = None


class Learning(Bake):
    """Springs of some mesh objects, from the frames of a simulation.

    Driven as a bake is: `run`, then `finish`, or `cancel`. Nothing in the file changes before `finish`, which writes the constants
    as attributes of the meshes. Flesh is simulated with each object's own paint and simulation settings, without gravity.

    Parameters
    ----------
    scene, objects, frames
        As for `Bake`; frames of pre-roll and cycles are learned from as well.
    fit
        How the constants are found.

    Raises
    ------
    ValueError
        As `Bake` does, and where there are fewer than `LEAST_FRAMES` frames.
    """

    def __init__(
        self,
        scene: bpy.types.Scene,
        objects: Mapping[str, ObjectSettings],
        frames: FrameRange | None = None,
        fit: FitSettings | None = None,
    ) -> None:
        self._settings = {name: settings.motion.springs for name, settings in objects.items()}
        self._fit_settings = fit or FitSettings()
        self._recordings = {name: _Recording() for name in objects}
        flesh = {
            name: replace(
                settings, motion=_simulated(settings.motion), output="keys"
            )  # the mesh is changed, whatever is baked
            for name, settings in objects.items()
        }
        super().__init__(scene, flesh, frames)
        count = self.end - self.start + 1
        if count < LEAST_FRAMES:
            self.cancel()
            raise ValueError(f"frames: found {count}, expected {LEAST_FRAMES} or more to learn from")

    @property
    def total(self) -> int:
        """Number of steps: frames to simulate, and blocks of vertices to fit."""
        return len(self._schedule) + sum(len(blocks_of(character.offsets.shape[1])) for character in self._characters)

    def finish(self) -> LearningReport:  # type: ignore[override]  # of something else
        """Write the constants of all objects and put the scene's frame back.

        Raises
        ------
        RuntimeError
            Where `run` has not come to its end.
        """
        if not self._complete or self._closed:
            raise RuntimeError("finish: this simulation has not been run to its end")
        for character in self._characters:
            obj = bpy.data.objects.get(character.name)
            if obj is None or len(obj.data.vertices) != character.offsets.shape[1]:
                self.cancel()
                raise NotBakeableError(f"Object '{character.name}' has been removed or changed: learn again")
        self._put_back()
        learned = []
        for character in self._characters:
            recording = self._recordings[character.name]
            fit = recording.fit
            assert fit is not None and recording.painted is not None  # run has come to its end
            known = fit.status == FitStatus.FITTED
            write_learned(
                bpy.data.objects[character.name],
                LearnedSprings(
                    np.where(known, np.maximum(fit.stiffness, LEAST_STIFFNESS), 0.0),
                    np.where(known, fit.damping, 0.0),
                    recording.painted,
                    self._settings[character.name].damping_ratio,
                ),
            )
            learned.append(
                ObjectLearning(
                    character.name,
                    len(known),
                    int(known.sum()),
                    fit.rmse,
                    fit.reference_rmse,
                    len(character.unconverged),
                )
            )
        modes.enter_modes(self._modes)
        self._back_to_frame()
        self._closed = True
        return LearningReport(tuple(learned), self.start, self.end, time.perf_counter() - self._began)

    def _make_finder(self, *_arguments: object) -> None:  # type: ignore[override]
        """Nothing is looked for: displacements are all that is wanted."""
        return None

    def _prepare(self, scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange) -> None:
        super()._prepare(scene, objects, frames)
        self._searched = list(self._characters)  # what follows the simulation is the fit, for all of them

    def _read_paint(
        self,
        obj: bpy.types.Object,
        surface: Surface,
        settings: ObjectSettings,
        weights: VertexWeights,
        tets: Callable[[], mesh.TetMesh],
    ) -> Paint:
        paint = super()._read_paint(obj, surface, settings, weights, tets)
        self._recordings[obj.name].painted = painted_stiffness(paint.stiffness, paint.mass, self._settings[obj.name])
        return paint

    def _take_poses(self) -> list[Pose]:
        poses = super()._take_poses()
        for character, pose in zip(self._characters, poses, strict=True):
            self._recordings[character.name].reference.append(_surface(character.motion.volume, pose))
        return poses

    def _row(self, *_arguments: object) -> None:
        """Nowhere: recordings take what comes."""
        return None

    def _collect(self, index: int) -> None:
        frame, _ = self._schedule[index]
        for character in self._characters:
            recording = self._recordings[character.name]
            with _told_apart(f"Object '{character.name}', frame {frame}"):
                result = character.motion.finish()
                assert result.displacements is not None
                if not np.isfinite(result.displacements).all():
                    raise ValueError("the motion is no longer finite")
            if not result.converged and character.motion.settings.simulation.quality != "preview":
                character.unconverged.add(frame)
            recording.displacements.append(result.displacements)

    def _searches(self) -> Iterator[Progress]:
        """Fit, a block of vertices a step."""
        done = len(self._schedule)
        for character in self._characters:
            recording = self._recordings[character.name]
            with _told_apart(f"Object '{character.name}'"):
                fitting = Fitting(
                    [_training(recording, self._dt)], self._fit_settings, skipped=_held(character.motion.volume)
                )
                for block in fitting.blocks:
                    fitting.fit(block)
                    done += 1
                    if done < self.total:
                        yield Progress(done=done, total=self.total, frame=self.end)
                recording.fit = fitting.result()
        self._complete = True
        yield Progress(done=done, total=self.total, frame=self.end)


def _surface(volume: Volume, pose: Pose) -> FloatArray:
    """Where the rig alone puts the surface's vertices, (v, 3) in the world, m: as the volume carries them."""
    tets = volume.tet_mesh
    return mesh.interpolate(volume.reference(pose), tets.tets, tets.embedding_tets, tets.embedding_weights)


def _held(volume: Volume) -> NDArray[np.bool_]:
    """Vertices (v,) of the surface that pins hold exactly: their springs would never be seen."""
    tets = volume.tet_mesh
    corners = tets.tets[tets.embedding_tets]
    held: NDArray[np.bool_] = (volume.pinned[corners] | (tets.embedding_weights == 0)).all(axis=1)
    return held


def _training(recording: _Recording, dt: float) -> Training:
    """The frames that were simulated; the first one is where the simulation started."""
    reference = np.array(recording.reference[: len(recording.displacements) + 1])
    dynamic = reference.copy()
    dynamic[1:] += recording.displacements
    return Training(reference, dynamic, dt)


def _simulated(motion: Settings) -> Settings:
    """The same character as flesh, as its simulation has it, without what would be in the springs twice."""
    return Settings(
        volume=motion.volume,
        solver="implicit-euler",
        simulation=replace(motion.simulation, gravity=0.0),
        minimum_stretch=motion.minimum_stretch,
    )
