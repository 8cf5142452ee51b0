# SPDX-License-Identifier: GPL-3.0-or-later
"""Live preview: the same motion as a bake's, one frame whenever the timeline goes one further, without baking anything.

Each frame is the bake's: the pose that Blender has evaluated goes to `SecondaryMotion.step`, and its offsets to a shape key, one for all
frames (`preview_key`). Emulator and Simulation show what a bake gives, to the bit. Springs are shown without their look ahead.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough.blender import preview_key
from followthrough.blender.bake import ObjectSettings, is_finite, same_pose
from followthrough.blender.groups import read_paint
from followthrough.blender.rig_reading import PoseReader, make_reader, read_bare_surface, with_skeleton
from followthrough.blender.scene import (
    NotBakeableError,
    evaluated_view_layer,
    frame_time,
    require_bakeable,
    require_posed,
    require_visible,
    skeletons_of,
)
from followthrough.blender.vertex_weights import read_weights
from followthrough.character import BonePose, FloatArray, Paint, Pose, Surface
from followthrough.secondary_motion import SecondaryMotion

#: So many frames may be left out, as playback does that keeps its pace; what they would have shown is simulated all the same.
MOST_LEFT_OUT = 6
#: Share of the newest frame in the means that are shown.
_NEWEST = 0.15
#: Paint is read again after this many times the time that reading took.
_REST = 10.0


@dataclass
class _Character:
    """One object while it is previewed."""

    name: str
    settings: ObjectSettings
    surface: Surface
    paint: Paint
    motion: SecondaryMotion
    reader: PoseReader
    basis: NDArray[np.float32]
    offsets: FloatArray
    pose: Pose | None = None
    #: When what is painted may be read again: scrubbing backwards begins anew in every frame.
    read_again: float = 0.0


class Preview:
    """Secondary motion of some mesh objects that follows the timeline. `end` leaves the file as it was.

    Parameters
    ----------
    scene
        The objects' scene.
    objects
        Settings of every object, by name.
    loop
        First and last frame of a cycle: playing from its end to its start goes on then, instead of beginning anew.

    Attributes
    ----------
    milliseconds : float
        What a frame takes beside what Blender itself does, about.
    frames_per_second : float
        How fast frames come, about; 0 where they do not.

    Raises
    ------
    NotBakeableError
        Where an object could not be baked either, is in a mode that shows another shape, or something else than the bones of one
        armature moves it: its offsets have to be searched, which a bake does.
    ValueError
        Where a setting does not fit.
    """

    def __init__(
        self,
        scene: bpy.types.Scene,
        objects: Mapping[str, ObjectSettings],
        loop: tuple[int, int] | None = None,
    ) -> None:
        if not objects:
            raise NotBakeableError("there is no object to preview: choose a mesh that an armature moves")
        self._scene = scene.name
        self._dt = frame_time(scene)
        self._loop = loop
        self._frame: int | None = None
        self._asleep = False
        self._shown_at: float | None = None
        self.milliseconds = self.frames_per_second = 0.0
        view_layer = evaluated_view_layer(scene)
        for name in objects:
            require_visible(name, scene, view_layer)
            _require_previewable(bpy.data.objects[name])
        self._characters = [self._read(bpy.data.objects[name], settings) for name, settings in objects.items()]
        try:
            for character in self._characters:
                character.basis = preview_key.put(bpy.data.objects[character.name])
        except BaseException:
            self.end()
            raise

    @property
    def object_names(self) -> tuple[str, ...]:
        """What is previewed."""
        return tuple(character.name for character in self._characters)

    @property
    def volume_vertex_counts(self) -> dict[str, int]:
        """Simulated vertices of each object, by name."""
        return {made.name: len(made.motion.volume.tet_mesh.vertices) for made in self._characters}

    def show(self, scene: bpy.types.Scene, settings: Mapping[str, ObjectSettings] | None = None) -> None:
        """Show the scene's current frame, which Blender has evaluated.

        One frame further than the last time is a step of the solver; a few further are as many steps, through poses between the two. All
        else begins anew, at rest in the pose of the frame, with what is painted then.

        Parameters
        ----------
        settings
            What is set now. Where that has changed, the motion begins anew.

        Raises
        ------
        ValueError
            Where an object is gone or can no longer be previewed, or the motion is not finite.
        """
        if scene.name != self._scene or self._asleep:
            return
        began, frame = time.perf_counter(), scene.frame_current
        changed = settings is not None and self._take_settings(settings)
        self._dt_of(scene)
        if frame == self._frame and not changed:
            return
        poses = self._read_poses(evaluated_view_layer(scene))
        steps = 0 if changed or self._frame is None else self._steps_to(frame, poses)
        for character, pose in zip(self._characters, poses, strict=True):
            if steps is None:  # the end of a loop, which is its start
                continue
            if steps == 0:
                self._begin(character, pose)
            else:
                _step(character, pose, steps)
            character.pose = pose
        self._frame = frame
        self._write()
        self._measure(began, bool(steps))

    def sleep(self) -> None:
        """Take all traces off for a while, as for saving the file."""
        self._asleep = True
        preview_key.remove_left_over()  # whatever the objects are called by now

    def wake(self) -> None:
        """Go on after `sleep`, where it stopped."""
        self._asleep = False
        self._write()

    def pause(self) -> None:
        """Show nothing for a while, as while pictures are rendered, in whatever thread that is."""
        self._asleep = True
        for name in self.object_names:
            if name in bpy.data.objects:
                preview_key.pause(bpy.data.objects[name])

    def unpause(self) -> None:
        """Go on after `pause`."""
        self._asleep = False
        for name in self.object_names:
            if name in bpy.data.objects:
                preview_key.unpause(bpy.data.objects[name])

    def end(self) -> None:
        """Leave everything as it was before; safe at any time and more than once."""
        self.sleep()

    def _read(self, obj: bpy.types.Object, settings: ObjectSettings) -> _Character:
        deformation = require_bakeable(obj)
        weights = read_weights(obj)
        surface = with_skeleton(obj, read_bare_surface(obj), weights)
        paint = read_paint(obj, surface, settings.groups, weights)
        nothing = np.zeros((len(surface.rest_positions), 3))
        return _Character(
            name=obj.name,
            settings=settings,
            surface=surface,
            paint=paint,
            motion=SecondaryMotion(surface, paint, settings.motion, self._dt),
            reader=make_reader(obj, deformation, surface),
            basis=nothing.astype(np.float32),
            offsets=nothing,
        )

    def _begin(self, character: _Character, pose: Pose) -> None:
        """Begin at rest in a pose; what is painted otherwise by now makes a new motion."""
        began, obj = time.perf_counter(), bpy.data.objects[character.name]
        if obj.mode not in {"EDIT", "SCULPT"} and began >= character.read_again:
            paint = read_paint(obj, character.surface, character.settings.groups)
            ended = time.perf_counter()
            character.read_again = ended + _REST * (ended - began)
            if not _same_paint(paint, character.paint):
                character.paint = paint
                self._make_motion(character)
        frame = character.motion.reset(pose)
        assert frame.offsets is not None  # of a rig, as it is required to be
        character.offsets = frame.offsets

    def _make_motion(self, character: _Character, same_volume: bool = True) -> None:
        tets = character.motion.volume.tet_mesh if same_volume else None
        motion = character.settings.motion
        character.motion = SecondaryMotion(character.surface, character.paint, motion, self._dt, tets)

    def _steps_to(self, frame: int, poses: list[Pose]) -> int | None:
        """How many steps lead to a frame; 0: it begins anew, None: nothing moves."""
        assert self._frame is not None
        if self._loop is not None and (self._frame, frame) == (self._loop[1], self._loop[0]):
            ends = zip(self._characters, poses, strict=True)
            return None if all(at.pose is not None and same_pose(at.pose, pose) for at, pose in ends) else 1
        further = frame - self._frame
        return further if 0 < further <= MOST_LEFT_OUT + 1 else 0

    def _read_poses(self, view_layer: bpy.types.ViewLayer) -> list[Pose]:
        poses = []
        for character in self._characters:
            obj = bpy.data.objects.get(character.name)
            if obj is None or len(obj.data.vertices) != len(character.basis):
                raise NotBakeableError(f"Object '{character.name}' has been removed or changed")
            pose = character.reader.read(view_layer)
            if not is_finite(pose):
                raise ValueError(f"Object '{character.name}': the pose is not finite (NaN or infinity)")
            poses.append(pose)
        return poses

    def _take_settings(self, settings: Mapping[str, ObjectSettings]) -> bool:
        changed = False
        for character in self._characters:
            now = settings.get(character.name)
            if character.name not in bpy.data.objects:
                raise NotBakeableError(f"Object '{character.name}' has been removed or renamed")
            if now is None:
                raise NotBakeableError(f"Object '{character.name}' has no Followthrough any more")
            if now != character.settings:
                same_volume = now.motion.volume == character.settings.motion.volume
                character.settings, changed = now, True
                character.paint = read_paint(bpy.data.objects[character.name], character.surface, now.groups)
                self._make_motion(character, same_volume)
        return changed

    def _dt_of(self, scene: bpy.types.Scene) -> None:
        if self._dt != frame_time(scene):
            self._dt = frame_time(scene)
            self._frame = None
            for character in self._characters:
                self._make_motion(character)

    def _write(self) -> None:
        for character in self._characters:
            obj = bpy.data.objects.get(character.name)
            if obj is None or obj.mode in {"EDIT", "SCULPT"}:
                continue
            if not preview_key.is_on(obj):  # undo has gone back to before it
                character.basis = preview_key.put(obj)
            preview_key.show(obj, character.basis, character.offsets)

    def _measure(self, began: float, stepped: bool) -> None:
        now = time.perf_counter()
        if not stepped:
            self._shown_at = now
            return
        spent = 1e3 * (now - began)
        self.milliseconds += (spent - self.milliseconds) * (_NEWEST if self.milliseconds else 1.0)
        if self._shown_at is not None:
            rate = 1.0 / max(now - self._shown_at, 1e-6)
            self.frames_per_second += (rate - self.frames_per_second) * (_NEWEST if self.frames_per_second else 1.0)
        self._shown_at = now


def why_not_previewable(obj: bpy.types.Object) -> str | None:
    """Reason why this object cannot be previewed, a sentence for the artist; None where it can. Quick enough for a panel."""
    try:
        _require_previewable(obj)
    except NotBakeableError as problem:
        return str(problem)
    return None


def _require_previewable(obj: bpy.types.Object) -> None:
    deformation = require_bakeable(obj)
    require_posed(obj)
    for part in (obj, *skeletons_of(obj)):
        if part.mode in {"EDIT", "SCULPT"}:
            raise NotBakeableError(f"Object '{part.name}' is in {part.mode.title()} Mode: leave it to see the preview")
    if deformation.armature is None:
        raise NotBakeableError(
            f"Object '{obj.name}' is moved by more than the bones of one armature (modifiers, bendy bones, shape keys): it cannot be "
            "previewed live, but it can be baked"
        )


def _step(character: _Character, pose: Pose, steps: int) -> None:
    """So many frames to a pose, those before the last one between the last pose and this."""
    before = character.pose
    assert isinstance(pose, BonePose) and isinstance(before, BonePose)
    for done in range(1, steps + 1):
        frame = character.motion.step(pose if done == steps else _between(before, pose, done / steps))
    assert frame.offsets is not None
    if not np.isfinite(frame.offsets).all():
        raise ValueError(f"Object '{character.name}': the motion is no longer finite")
    character.offsets = frame.offsets


def _between(first: BonePose, last: BonePose, share: float) -> BonePose:
    """A pose on the way: matrices in equal steps, good enough for the few frames that playback leaves out."""
    armature = last.armature
    if first.armature is not None and last.armature is not None:
        armature = first.armature + share * (last.armature - first.armature)
    return BonePose(
        bone_matrices=first.bone_matrices + share * (last.bone_matrices - first.bone_matrices),
        world=first.world + share * (last.world - first.world),
        armature=armature,
    )


def _same_paint(first: Paint, second: Paint) -> bool:
    names = ("stiffness", "mass", "pins")
    if not all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names):
        return False
    before, after = first.learned, second.learned
    if before is None or after is None:
        return before is after
    names = ("stiffness", "damping", "painted_stiffness")
    return all(np.array_equal(getattr(before, name), getattr(after, name)) for name in names)
