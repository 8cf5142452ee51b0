# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake: steps through the frames once for all objects, and writes their shape keys at the end."""

from __future__ import annotations

import concurrent.futures
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender import actions, modes, outputs
from followthrough.blender.bake_cache import BakeCache, plan_of
from followthrough.blender.bake_recovery import Recovery
from followthrough.blender.bake_report import BakeReport, ObjectReport
from followthrough.blender.baked_character import BakedCharacter
from followthrough.blender.earlier_bake import HiddenBake, hide_bake, show_bake
from followthrough.blender.groups import PaintGroups, read_paint
from followthrough.blender.outputs import OUTPUTS, OutputKind
from followthrough.blender.probes import OffsetFinder
from followthrough.blender.rig_reading import make_reader, read_bare_surface, with_skeleton
from followthrough.blender.scene import (
    Deformation,
    NotBakeableError,
    evaluated_view_layer,
    frame_time,
    require_bakeable,
    require_posed,
    require_visible,
    skeletons_of,
)
from followthrough.blender.still_meshes import StillMeshes
from followthrough.blender.vertex_weights import VertexWeights, read_weights
from followthrough.blender.work_beside import work_beside_blender
from followthrough.character import BonePose, Paint, Pose, Surface
from followthrough.mesh import TetMesh
from followthrough.secondary_motion import SecondaryMotion
from followthrough.settings import Settings, VolumeSettings
from followthrough.volume import make_tets

#: Poses that are read before they are needed take so many bytes at most.
LOOK_AHEAD = 2**26
#: Seconds for which poses are read at once.
BURST = 0.02
#: Frames that are under way at once, at most, where all objects' are quick; otherwise it is one.
UNDER_WAY = 64


@dataclass(frozen=True)
class ObjectSettings:
    """How one object is baked: volume and solver, which vertex groups are read, and what is written."""

    motion: Settings = field(default_factory=Settings)
    groups: PaintGroups = field(default_factory=PaintGroups)
    output: OutputKind = "keys"

    def __post_init__(self) -> None:
        if self.output not in OUTPUTS:
            raise ValueError(f"output: found {self.output!r}, expected {' or '.join(OUTPUTS)}")


@dataclass(frozen=True)
class FrameRange:
    """Which frames are baked.

    Parameters
    ----------
    start, end
        First and last frame; None: the scene's.
    preroll
        Frames that are simulated before the first one and not keyed.
    cycles
        Where more than 0, the range is a loop: it is simulated so many times before it is baked, so that its end leads
        into its start. Where the last frame repeats the pose of the first one, they count as one.
    """

    start: int | None = None
    end: int | None = None
    preroll: int = 0
    cycles: int = 0

    def __post_init__(self) -> None:
        for name in ("preroll", "cycles"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name}: found {getattr(self, name)}, expected 0 or more")

    def ends_in(self, scene: bpy.types.Scene) -> tuple[int, int]:
        """First and last frame, of the scene where they are not given."""
        return (
            scene.frame_start if self.start is None else self.start,
            scene.frame_end if self.end is None else self.end,
        )


@dataclass(frozen=True)
class Progress:
    """After one step: `done` of `total` frames are simulated or under way, the last of them `frame`."""

    done: int
    total: int
    frame: int


class Bake:
    """Secondary motion of some mesh objects over a range of frames.

    Making one checks everything and builds the volumes. Nothing in the file changes before `finish`, except that until
    `finish` or `cancel`, which put it back, the scene's current frame moves, an earlier bake of the objects is muted,
    and objects and armatures in Edit or Sculpt Mode leave it.

    Parameters
    ----------
    scene
        The objects' scene.
    objects
        Settings of every object to bake, by object name.
    frames
        Which frames; the scene's where it is None.
    cache
        Folder (`bake_cache.cache_folder`) in which the bake keeps what it has done, and goes on from where an earlier one of the same
        characters, settings and animation has stopped. It is removed at the end. None: neither.

    blend
        The .blend that will play the bake, beside which point caches are written; None: the one that is open.

    Attributes
    ----------
    recovery : Recovery
        What is in the cache, and whether it is used.

    Raises
    ------
    NotBakeableError
        Where an object is missing or cannot be baked.
    ValueError
        Where the range is empty or a setting does not fit.
    """

    def __init__(
        self,
        scene: bpy.types.Scene,
        objects: Mapping[str, ObjectSettings],
        frames: FrameRange | None = None,
        cache: Path | None = None,
        blend: Path | None = None,
    ) -> None:
        frames = frames or FrameRange()
        objects = dict(sorted(objects.items()))  # a cache is the same in whatever order they were selected
        self._began = time.perf_counter()
        self._scene = scene.name
        self.start, self.end = frames.ends_in(scene)
        if self.end < self.start:
            raise ValueError(f"frames: found start {self.start} and end {self.end}, expected at least one frame")
        if not objects:
            raise NotBakeableError("there is no object to bake: choose a mesh that an armature moves")
        view_layer = self._view_layer()
        self._blend = blend or (Path(bpy.data.filepath) if bpy.data.filepath else None)
        for name, settings in objects.items():
            require_visible(name, scene, view_layer)
            require_bakeable(bpy.data.objects[name], settings.output)
            if settings.output == "pc2" and self._blend is None:
                raise NotBakeableError("a point cache lies beside its .blend: save the file first")
            require_posed(bpy.data.objects[name])
        self._dt = frame_time(scene)
        self._frame = (scene.frame_current, scene.frame_subframe)
        self._restore: list[Callable[[], None]] = []
        self._modes: dict[str, str] = {}
        self._outputs = {name: settings.output for name, settings in objects.items()}
        self._complete = self._closed = False
        self._characters: list[BakedCharacter] = []
        self._ahead: deque[list[Pose]] = deque()
        self._under_way: deque[Progress] = deque()
        self._cache = cache
        try:
            self._prepare(scene, objects, frames)
        except BaseException:
            self.cancel()
            raise

    @property
    def total(self) -> int:
        """Number of steps: frames to simulate, pre-roll and cycles included, and frames whose offsets are searched."""
        searched = self.end - self.start + 1 if self._searched else 0
        return len(self._schedule) + searched

    @property
    def cautions(self) -> tuple[str, ...]:
        """Sentences for the artist about what the solvers are not made for, known before anything is simulated; usually none."""
        return tuple(f"{made.name}: {made.motion.caution}" for made in self._characters if made.motion.caution)

    def run(self, patience: float | None = None) -> Iterator[Progress]:
        """Simulate, one frame a step, and then search offsets where bones do not tell them. Leaving the loop early cancels.

        While the core simulates frames on a thread of its own, Blender already evaluates the next ones in this thread.

        Parameters
        ----------
        patience
            Where a frame takes longer than so many seconds, the latest progress comes again, so that the caller can look
            after other things. None: every frame comes once.

        Raises
        ------
        ValueError
            Where a result is not finite, naming object and frame, or an object has disappeared; the bake is then
            cancelled.
        """
        if self._closed or self._complete:
            raise RuntimeError("run: this bake has already been run")
        try:
            yield from self._steps(patience)
            yield from self._searches()
        finally:
            if not self._complete:
                self.cancel()

    def finish(self) -> BakeReport:
        """Write the shape keys or point caches of all objects and put the scene's frame back.

        Raises
        ------
        ValueError, OSError
            Where a point cache cannot be written.
        RuntimeError
            Where `run` has not come to its end.
        """
        if not self._complete or self._closed:
            raise RuntimeError("finish: this bake has not been run to its end")
        for character in self._characters:
            obj = bpy.data.objects.get(character.name)
            if obj is None or len(obj.data.vertices) != character.offsets.shape[1]:
                self.cancel()
                raise NotBakeableError(f"Object '{character.name}' has been removed or changed: bake again")
        # Evaluating so many keys takes Blender longer than writing them: that is left to whoever shows them.
        self._back_to_frame()
        self._put_back()
        frames, length = range(self.start, self.end + 1), actions.frame_length(bpy.data.scenes[self._scene])
        try:
            for character in self._characters:
                outputs.write(
                    bpy.data.objects[character.name],
                    self._outputs[character.name],
                    frames,
                    character.offsets,
                    character.rest_positions,
                    self._blend,
                    length,
                )
        except BaseException:
            self.cancel()
            raise
        modes.enter_modes(self._modes)
        self._closed = True
        self.recovery.end()
        return BakeReport(
            objects=tuple(self._report(character) for character in self._characters),
            start=self.start,
            end=self.end,
            seconds=time.perf_counter() - self._began,
        )

    def cancel(self) -> None:
        """Put everything back as it was before; safe at any time and more than once."""
        if self._closed:
            return
        self._closed = True
        for character in self._characters:
            character.abandon()
        self._put_back()
        modes.enter_modes(self._modes)
        self._back_to_frame()

    def _prepare(self, scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange) -> None:
        # An armature in Edit Mode shows its rest pose.
        armatures = {armature.name for name in objects for armature in skeletons_of(bpy.data.objects[name])}
        self._modes = modes.leave_modes([*objects, *sorted(armatures)])
        deformations = {
            name: require_bakeable(bpy.data.objects[name], settings.output) for name, settings in objects.items()
        }
        for name, deformation in deformations.items():
            obj = bpy.data.objects[name]
            self._hide_earlier_bake(obj)
            if deformation.armature is None:
                self._switch_off(obj, deformation.behind)
        scene.frame_set(self.start)
        self._still = StillMeshes(deformations, self._view_layer())
        self._restore.append(self._still.show)
        with work_beside_blender() as thread:
            for name, settings in objects.items():
                self._read_character(bpy.data.objects[name], settings, deformations[name], thread)
            self._searched = [character for character in self._characters if character.finder is not None]
            self._schedule = self._make_schedule(frames)
            self.recovery = self._make_recovery(objects, frames)
            # While the volumes are made on the thread, Blender steps the first frames here.
            self._read_ahead_until(self._characters[-1].made)
            for character in self._characters:
                character.made.result()

    def _read_character(
        self,
        obj: bpy.types.Object,
        settings: ObjectSettings,
        deformation: Deformation,
        thread: concurrent.futures.Executor,
    ) -> None:
        """Read an object; its volume and solver are made on the thread, the tets while the weights are read here."""
        bare = read_bare_surface(obj)
        tets = thread.submit(make_tets, bare, settings.motion.volume)
        weights = read_weights(obj)
        surface = bare if deformation.armature is None else with_skeleton(obj, bare, weights)
        paint = self._read_paint(obj, surface, settings, weights, tets.result)
        name = obj.name

        def make_motion() -> SecondaryMotion:
            with _told_apart(f"Object '{name}'"):
                return SecondaryMotion(surface, paint, settings.motion, self._dt, tets.result())

        made = thread.submit(make_motion)
        # Of large arrays NumPy asks for large pages, unless they are to be zero: every frame but the first is written anyway.
        offsets = np.empty((self.end - self.start + 1, len(surface.rest_positions), 3), dtype=np.float32)
        offsets[0] = 0.0
        finder = self._make_finder(obj, surface, settings.motion.minimum_stretch) if surface.rig is None else None
        reader = make_reader(obj, deformation, surface)
        self._characters.append(
            BakedCharacter(
                name, made, reader, finder, surface.rest_positions, offsets, unkeyed=np.empty_like(offsets[0])
            )
        )

    def _read_paint(
        self,
        obj: bpy.types.Object,
        surface: Surface,
        settings: ObjectSettings,
        weights: VertexWeights,
        tets: Callable[[], TetMesh],
    ) -> Paint:
        usual = settings.motion.volume == VolumeSettings()  # for which paint is suggested
        return read_paint(obj, surface, settings.groups, weights, tets if usual else None)

    def _read_ahead_until(self, made: concurrent.futures.Future[SecondaryMotion]) -> None:
        """Read poses in the order in which they are needed, for as long as that takes."""
        while not made.done() and self._read_ahead():
            pass

    def _read_ahead(self) -> bool:
        """Read the next pose that has not been read yet; False where there is none, no room for it, or it cannot be read.

        What is wrong with a pose is told when its turn comes.
        """
        room = max(1, LOOK_AHEAD // sum(map(_size, self._ahead[0]))) if self._ahead else 1
        if not self._unread or len(self._ahead) >= room:
            return False
        with suppress(ValueError):
            self._ahead.append(self._read(self._unread[0]))
            self._unread.popleft()
            return True
        return False

    def _read_burst(self) -> None:
        """Where few poses are left, read some at once: the threads that Blender evaluates with go on spinning for a while after a frame,
        and would slow down the one that simulates.
        """
        if len(self._ahead) < 2:
            until = time.monotonic() + BURST
            while self._read_ahead() and time.monotonic() < until:
                pass

    def _take_poses(self) -> list[Pose]:
        """The next poses, read ahead or now."""
        for character in self._characters:
            if character.name not in bpy.data.objects:
                raise NotBakeableError(f"Object '{character.name}' is no longer there")
        if self._ahead:
            return self._ahead.popleft()
        poses = self._read(self._unread[0])
        self._unread.popleft()
        return poses

    def _make_recovery(self, objects: Mapping[str, ObjectSettings], frames: FrameRange) -> Recovery:
        return Recovery(
            cache=None if self._cache is None else BakeCache(self._cache, self._scene, objects),
            plan=plan_of(bpy.data.scenes[self._scene], objects, frames),
            characters=self._characters,
            scheduled=[frame for frame, _ in self._schedule],
            keyed=self.end - self.start + 1,
        )

    def _make_finder(self, obj: bpy.types.Object, surface: Surface, minimum_stretch: float) -> OffsetFinder:
        finder = OffsetFinder(obj.name, surface.rest_positions, minimum_stretch)
        self._restore.append(finder.remove)
        finder.require_effect(self._view_layer())
        return finder

    def _make_schedule(self, frames: FrameRange) -> list[tuple[int, bool]]:
        """Frames to simulate, and whether they are keyed; after a loop's last one, the frame that follows it is read, too."""
        after: int | None = None
        schedule = [(frame, False) for frame in range(self.start - frames.preroll, self.start)]
        if frames.cycles:
            first, last = self._read(self.start), self._read(self.end)
            closed = self.end > self.start and all(map(same_pose, first, last))
            loop = range(self.start, self.end if closed else self.end + 1)
            schedule += [(frame, False) for _ in range(frames.cycles) for frame in loop]
            after = self.start + int(closed)
        schedule += [(frame, True) for frame in range(self.start, self.end + 1)]
        self._frames_to_read = [frame for frame, _ in schedule] + ([] if after is None else [after])
        self._unread = deque(self._frames_to_read)
        return schedule

    def _steps(self, patience: float | None) -> Iterator[Progress]:
        poses = self._take_poses()
        for character, pose in zip(self._characters, poses, strict=True):
            with _told_apart(f"Object '{character.name}', frame {self._schedule[0][0]}"):
                character.motion.reset(pose)
        self.recovery.poses.add(poses)
        first, poses = yield from self._resume(poses)
        for done in range(first, len(self._schedule)):
            self._read_burst()
            next_poses = self._take_poses() if self._ahead or self._unread else None
            yield from self._make_room(patience)
            progress = Progress(done=done + 1, total=self.total, frame=self._schedule[done][0])
            if done:
                self._begin(done, poses, next_poses)
                self._under_way.append(progress)
            if next_poses is not None and done + 1 < len(self._schedule):
                poses = next_poses
                self.recovery.poses.add(poses)
            if done + 1 < len(self._schedule):
                yield progress
        yield from self._collect_until(0, patience)
        if self._searched and first < len(self._schedule):
            self.recovery.save(len(self._schedule), always=True)  # the displacements, before offsets take their place
        self._complete = not self._searched
        yield Progress(done=len(self._schedule), total=self.total, frame=self._schedule[-1][0])

    def _resume(self, poses: list[Pose]) -> Generator[Progress, None, tuple[int, list[Pose]]]:
        """Go on where the cache ends, if it is of this bake: step through the frames again, without simulating them.

        Takes the first frame's poses; returns how many frames are simulated, and the poses of the next one.
        """
        saved = self.recovery.load()
        if saved is None:
            return 0, poses
        first = poses
        for done in range(1, min(saved.done + 1, len(self._schedule))):
            poses = self._take_poses()
            self.recovery.poses.add(poses)
            yield Progress(done=done, total=self.total, frame=self._schedule[done - 1][0])
        if self.recovery.restore(saved):
            return saved.done, poses
        self._ahead.clear()
        self._unread = deque(self._frames_to_read[1:])
        self.recovery.poses.add(first)
        for character, pose in zip(self._characters, first, strict=True):
            character.motion.reset(pose)
        return 0, first

    def _make_room(self, patience: float | None) -> Iterator[Progress]:
        """Collect frames where there is no room for another one: half of them, so that threads seldom wait for each other. Where the cache
        is to be written, all of them, as it knows the solvers after the last one alone.
        """
        most = UNDER_WAY if all(character.motion.is_quick for character in self._characters) else 1
        if self.recovery.is_due:
            yield from self._collect_until(0, patience)
        elif len(self._under_way) >= most:
            yield from self._collect_until(most // 2, patience)

    def _collect_until(self, left: int, patience: float | None) -> Iterator[Progress]:
        """Collect the oldest frames under way, until so many are left."""
        while len(self._under_way) > left:
            if patience is not None:
                for character in self._characters:
                    while not character.motion.wait(patience):
                        yield self._under_way[-1]
            done = self._under_way.popleft().done
            self._collect(done - 1)
            if not self._under_way:
                self.recovery.save(done)

    def _searches(self) -> Iterator[Progress]:
        """Turn the displacements of what bones alone do not move into offsets, frame by frame."""
        for frame in range(self.start, self.end + 1) if self._searched else ():
            keyed = frame - self.start + 1
            if any(character.found < keyed for character in self._searched):
                self._scene_in(frame)
                for character in self._searched:
                    with _told_apart(f"Object '{character.name}', frame {frame}"):
                        self._search(character, frame)
                    character.found = keyed
                self.recovery.save(len(self._schedule))
            self._complete = frame == self.end
            yield Progress(done=len(self._schedule) + keyed, total=self.total, frame=frame)

    def _search(self, character: BakedCharacter, frame: int) -> None:
        assert character.finder is not None
        view_layer = self._view_layer()
        to_world = character.reader.read(view_layer).world[:3, :3]
        displacements = character.offsets[frame - self.start].astype(np.float64)
        found = character.finder.find(view_layer, displacements @ np.linalg.inv(to_world).T)
        character.offsets[frame - self.start] = found.offsets
        residuals = np.linalg.norm(found.residuals @ to_world.T, axis=1)
        character.largest_residual = max(character.largest_residual, float(residuals.max()))
        character.evaluations += found.evaluations

    def _begin(self, index: int, poses: list[Pose], following: list[Pose] | None) -> None:
        """Start a frame of all objects; the core works on it while Blender evaluates the next ones here."""
        frame = self._schedule[index][0]
        for place, character in enumerate(self._characters):
            with _told_apart(f"Object '{character.name}', frame {frame}"):
                after = None if following is None else following[place]
                character.motion.begin(poses[place], after, self._row(character, index))

    def _row(self, character: BakedCharacter, index: int) -> NDArray[np.float32] | None:
        """Where a frame's result goes; None where `_collect` takes it."""
        frame, keyed = self._schedule[index]
        return character.offsets[frame - self.start] if keyed else character.unkeyed

    def _collect(self, index: int) -> None:
        frame, keyed = self._schedule[index]
        for character in self._characters:
            with _told_apart(f"Object '{character.name}', frame {frame}"):
                result = character.motion.finish()
            if not result.converged and character.motion.settings.simulation.quality != "preview":
                character.unconverged.add(frame)
            if keyed:
                character.largest_displacement = max(character.largest_displacement, result.largest_displacement)
                character.largest_residual = max(character.largest_residual, result.largest_residual)

    def _read(self, frame: int) -> list[Pose]:
        self._scene_in(frame)
        view_layer = self._view_layer()
        with _told_apart(f"frame {frame}"):
            poses = [character.reader.read(view_layer) for character in self._characters]
        for character, pose in zip(self._characters, poses, strict=True):
            if not is_finite(pose):
                raise ValueError(f"Object '{character.name}', frame {frame}: the pose is not finite (NaN or infinity)")
        return poses

    def _scene_in(self, frame: int) -> None:
        scene = bpy.data.scenes.get(self._scene)
        if scene is None:
            raise NotBakeableError(f"Scene '{self._scene}' is no longer there")
        self._still.hold()
        scene.frame_set(frame)

    def show(self) -> None:
        """Between two frames: let Blender show the objects deformed in the scene's current frame, until the next one is read."""
        if not self._closed:
            self._still.show()

    def _view_layer(self) -> bpy.types.ViewLayer:
        return evaluated_view_layer(bpy.data.scenes[self._scene])

    def _hide_earlier_bake(self, obj: bpy.types.Object) -> None:
        name, hidden = obj.name, hide_bake(obj)
        if hidden != HiddenBake():
            self._restore.append(lambda: show_bake(name, hidden))

    def _switch_off(self, obj: bpy.types.Object, modifiers: tuple[str, ...]) -> None:
        """Hide modifiers behind the deformation, which would change the number of vertices."""

        def show(visible: bool, name: str = obj.name) -> None:
            found = bpy.data.objects.get(name)
            for modifier in modifiers:
                if found is not None and modifier in found.modifiers:
                    found.modifiers[modifier].show_viewport = visible

        self._restore.append(lambda: show(True))
        show(False)

    def _put_back(self) -> None:
        while self._restore:
            self._restore.pop()()

    def _back_to_frame(self) -> None:
        scene = bpy.data.scenes.get(self._scene)
        if scene is not None:
            scene.frame_set(self._frame[0], subframe=self._frame[1])

    def _report(self, character: BakedCharacter) -> ObjectReport:
        volume = character.motion.volume
        return ObjectReport(
            name=character.name,
            frames=len(character.offsets),
            vertices=character.offsets.shape[1],
            tets=len(volume.tet_mesh.tets),
            largest_displacement=character.largest_displacement,
            largest_residual=character.largest_residual,
            evaluations_per_frame=character.evaluations / len(character.offsets),
            loose_vertices=character.motion.loose_vertex_count,
            unconverged=tuple(sorted(character.unconverged)),
            caution=character.motion.caution,
        )


@contextmanager
def _told_apart(place: str) -> Iterator[None]:
    """Say where it is that something goes wrong."""
    try:
        yield
    except ValueError as problem:
        raise ValueError(f"{place}: {problem}") from problem


def is_finite(pose: Pose) -> bool:
    """Whether all numbers of a pose are."""
    local = pose.bone_matrices if isinstance(pose, BonePose) else pose.positions
    return bool(np.isfinite(local).all() and np.isfinite(pose.world).all())


def _size(pose: Pose) -> int:
    """Bytes, about."""
    return pose.bone_matrices.nbytes if isinstance(pose, BonePose) else pose.positions.nbytes


def same_pose(first: Pose, last: Pose) -> bool:
    """Whether two poses put a character in the same place, up to what importers and curves round."""
    if isinstance(first, BonePose) and isinstance(last, BonePose):
        pairs = [(first.bone_matrices, last.bone_matrices)]
    elif not isinstance(first, BonePose) and not isinstance(last, BonePose):
        pairs = [(first.positions, last.positions)]
    else:
        return False
    pairs.append((first.world, last.world))
    return all(np.allclose(a, b, rtol=1e-3, atol=1e-3 * max(1e-6, float(np.abs(a).max()))) for a, b in pairs)
