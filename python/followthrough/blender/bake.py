# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake: steps through the frames once for all objects, and writes their shape keys at the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import bpy

from followthrough.blender.groups import PaintGroups
from followthrough.settings import Settings


@dataclass(frozen=True)
class ObjectSettings:
    """How one object is baked: volume and springs, and which vertex groups are read."""

    motion: Settings = field(default_factory=Settings)
    groups: PaintGroups = field(default_factory=PaintGroups)


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
        into its start.
    """

    start: int | None = None
    end: int | None = None
    preroll: int = 0
    cycles: int = 0


@dataclass(frozen=True)
class Progress:
    """After one step: `done` of `total` frames are simulated, the scene stands on `frame`."""

    done: int
    total: int
    frame: int


@dataclass(frozen=True)
class ObjectReport:
    """What was baked on one object.

    Attributes
    ----------
    frames, vertices, tets : int
    largest_displacement : float
        Of all vertices and frames, metres in the world.
    largest_residual : float
        Largest part of a displacement that no shape key can show because the rig flattens the skin there, metres.
    sampled : bool
        True where something other than a plain Armature modifier moves the mesh, and it was sampled by probes.
    """

    name: str
    frames: int
    vertices: int
    tets: int
    largest_displacement: float
    largest_residual: float
    sampled: bool


@dataclass(frozen=True)
class BakeReport:
    """What was baked, and how long it took."""

    objects: tuple[ObjectReport, ...]
    start: int
    end: int
    seconds: float


class Bake:
    """Secondary motion of some mesh objects over a range of frames.

    Making one checks everything and builds the volumes; nothing in the file changes before `finish`, except that the
    scene's current frame moves (and objects in Edit Mode leave it) until `finish` or `cancel`, which put it back.

    Parameters
    ----------
    scene
        The objects' scene.
    objects
        Settings of every object to bake, by object name.
    frames
        Which frames; the scene's where it is None.

    Raises
    ------
    NotBakeableError
        Where an object is missing or cannot be baked.
    ValueError
        Where the range is empty or a setting does not fit.
    """

    def __init__(
        self, scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange | None = None
    ) -> None:
        raise NotImplementedError

    @property
    def total(self) -> int:
        """Number of frames to simulate, pre-roll and cycles included."""
        raise NotImplementedError

    def run(self) -> Iterator[Progress]:
        """Simulate, one frame a step.

        Raises
        ------
        ValueError
            Where a result is not finite, naming object and frame, or an object has disappeared; the bake is then
            cancelled.
        """
        raise NotImplementedError

    def finish(self) -> BakeReport:
        """Write the shape keys of all objects and put the scene's frame back.

        Raises
        ------
        RuntimeError
            Where `run` has not come to its end.
        """
        raise NotImplementedError

    def cancel(self) -> None:
        """Put everything back as it was before; safe at any time and more than once."""
        raise NotImplementedError
