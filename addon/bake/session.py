# SPDX-License-Identifier: GPL-3.0-or-later
"""The bake that is running, if one is: the operator drives it, the panel shows how far it is."""

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import bpy

from followthrough.blender import (
    Bake,
    BakeCache,
    FrameRange,
    ObjectSettings,
    cache_folder,
    resumable_frame,
)

#: Seconds after which a frame that is still being simulated lets go of Blender's thread.
PATIENCE = 0.05

_running: "BakeSession | None" = None


def running() -> "BakeSession | None":
    """The bake under way."""
    return _running


def idle(operator: type[bpy.types.Operator]) -> bool:
    """For an operator's poll: whether no bake is under way; where one is, the button's tooltip says so."""
    if running() is not None:
        operator.poll_message_set("A bake is under way")
        return False
    return True


def stop() -> None:
    """Cancel the bake under way; everything is as it was before it."""
    if _running is not None:
        _running.cancel()


def resumable(
    scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange | None = None
) -> int | None:
    """The frame at which a bake of these objects would go on where an earlier one was stopped; None where none was."""
    return resumable_frame(cache_folder(), scene, objects, frames or FrameRange())


def discard(scene: bpy.types.Scene, names: Iterable[str]) -> None:
    """Delete what a stopped bake of these objects has left."""
    BakeCache(cache_folder(), scene.name, names).remove()


def _resumable_bake(scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange | None) -> Bake:
    return Bake(scene, objects, frames, cache_folder())


class BakeSession:
    """A bake that can be advanced a little at a time.

    Parameters
    ----------
    scene, objects, frames
        As in `followthrough.blender.Bake`.
    make
        What is run, something that is driven as a bake; None: a bake that goes on where an earlier one was stopped.
    doing, finishing
        What the status line calls a step, and the end.

    Raises
    ------
    ValueError
        Where it cannot be baked, in words for the artist, or another bake is under way.
    """

    def __init__(
        self,
        scene: bpy.types.Scene,
        objects: Mapping[str, ObjectSettings],
        frames: FrameRange | None = None,
        make: Callable[[bpy.types.Scene, Mapping[str, ObjectSettings], FrameRange | None], Bake] | None = None,
        doing: str = "Baking frame",
        finishing: str = "Writing shape keys",
    ) -> None:
        global _running
        if _running is not None:
            raise ValueError("Another bake is under way")
        self._bake = (make or _resumable_bake)(scene, objects, frames)
        self._words = (doing, finishing)
        self._steps = self._bake.run(patience=PATIENCE)
        self._simulating_since = time.monotonic()
        self._done_before: int | None = None
        self.object_names = tuple(objects)
        self.done = 0
        self.is_simulated = False
        _running = self

    @property
    def total(self) -> int:
        """Frames to simulate, those that are not keyed included."""
        return self._bake.total

    def advance(self, seconds: float) -> bool:
        """Simulate for about so long: a part of a frame or many frames.

        Returns
        -------
        bool
            True when all are done and `finish` may be called.

        Raises
        ------
        ValueError
            Where the simulation cannot go on; the bake is then cancelled.
        """
        until = time.monotonic() + seconds
        try:
            for progress in self._steps:
                self.done = progress.done
                self._count_from_where_it_goes_on()
                if time.monotonic() >= until:
                    self._bake.show()
                    return False
        except BaseException:
            self.cancel()
            raise
        self.is_simulated = True
        return True

    @property
    def saved_frame(self) -> int | None:
        """The frame at which another bake would go on if this one were stopped now."""
        return self._bake.recovery.saved_frame

    def notes(self) -> tuple[str, ...]:
        """What an artist should know about going on from an earlier bake."""
        recovery, notes = self._bake.recovery, []
        if recovery.resumed_from is not None:
            notes.append(f"Resumed from frame {recovery.resumed_from}")
        if recovery.has_begun_anew:
            notes.append(
                "The mesh, its animation, its paint or what it has learned has changed since the bake was stopped: begun anew"
            )
        if recovery.problem is not None:
            notes.append(f"A stopped bake could not be resumed: {recovery.problem}")
        return tuple(notes)

    def finish(self) -> Any:
        """Write what was made, which is then over; the report of it."""
        try:
            report = self._bake.finish()
        except BaseException:
            self.cancel()
            raise
        self._forget()
        return report

    def cancel(self) -> None:
        """Put everything back as it was before; the bake is then over."""
        self._forget()
        self._bake.cancel()

    def _count_from_where_it_goes_on(self) -> None:
        """Frames that an earlier bake has simulated say nothing about how long the others will take."""
        if self._done_before is None and self._bake.recovery.resumed_from is not None:
            self._done_before, self._simulating_since = self.done, time.monotonic()

    def _forget(self) -> None:
        global _running
        if _running is self:
            _running = None

    def seconds_left(self) -> float | None:
        """How long the rest will take if it goes on like this; None while that cannot be said."""
        done = self.done - (self._done_before or 0)
        if not done:
            return None
        return (time.monotonic() - self._simulating_since) / done * (self.total - self.done)

    def status(self) -> str:
        """How far it is, for the panel."""
        if self.is_simulated:
            return self._words[1]
        frame = min(self.done + 1, self.total)
        left = self.seconds_left()
        if left is None:
            return f"{self._words[0]} {frame} of {self.total}"
        minutes, seconds = divmod(round(left), 60)
        return f"{self._words[0]} {frame} of {self.total}, {minutes}:{seconds:02d} left"
