# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps a bake's cache while it runs, and takes over what an earlier, interrupted bake has left in it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from followthrough.blender.bake_cache import BakeCache, PoseDigest, Saved, SavedObject, contents_of
from followthrough.blender.baked_character import BakedCharacter

#: Seconds of work that a crash may cost: so often the cache is written, after the frame that exceeds it.
SAVE_INTERVAL = 2.0


class Recovery:
    """What a bake has done, kept in its cache.

    Parameters
    ----------
    cache
        None: nothing is kept.
    plan
        `plan_of` the bake.
    characters
        Its objects, whose results are saved and restored.
    scheduled
        Scene frames in the order in which they are simulated; the last ones are keyed.
    keyed
        How many those are.

    Attributes
    ----------
    poses : PoseDigest
        Of the frames that were simulated and of the next one.
    resumed_from : int or None
        Frame of the scene at which the bake went on, once it has.
    saved_frame : int or None
        Frame of the scene at which another bake would go on; None where there is nothing in the cache.
    has_begun_anew : bool
        Whether there was a cache of other settings, meshes or animation, or a broken one; it is deleted.
    problem : str or None
        Why no more is written.
    """

    def __init__(
        self,
        cache: BakeCache | None,
        plan: str,
        characters: Sequence[BakedCharacter],
        scheduled: Sequence[int],
        keyed: int,
    ) -> None:
        self._cache = cache
        self._plan = plan
        self._characters = characters
        self._scheduled = scheduled
        self._keyed = keyed
        self._last_save = time.monotonic()
        self.poses = PoseDigest()
        self.resumed_from: int | None = None
        self.saved_frame: int | None = None
        self.has_begun_anew = False
        self.problem: str | None = None

    def load(self) -> Saved | None:
        """What is in the cache, where it is of these settings, meshes and paint; otherwise it is deleted."""
        if self._cache is None or not self._cache.path.exists():
            return None
        saved = self._cache.load()
        if (
            saved is not None
            and (saved.plan, len(saved.objects)) == (self._plan, len(self._characters))
            and saved.contents == self._contents
            and 0 < saved.done <= len(self._scheduled)
        ):
            return saved
        self._discard()
        return None

    def restore(self, saved: Saved) -> bool:
        """Take over frames and states, once `poses` has those that were saved; False, and the cache is deleted, where they are others
        or something is broken.
        """
        if self.poses.text() == saved.poses and self._take_over(saved):
            self.resumed_from = self.saved_frame = saved.frame
            self._last_save = time.monotonic()
            return True
        self._discard()
        self.poses = PoseDigest()
        return False

    @property
    def is_due(self) -> bool:
        """Whether what has been done since the last time is worth writing."""
        return self._cache is not None and time.monotonic() - self._last_save >= SAVE_INTERVAL

    def save(self, done: int, always: bool = False) -> None:
        """Write what has been done since the last time, where that is worth it. No frame may be under way: solvers would be ahead.

        Parameters
        ----------
        done
            Frames that were simulated.
        always
            Whether it is worth it in any case.
        """
        if self._cache is None or not (always or self.is_due):
            return
        if done < len(self._scheduled):
            frame = self._scheduled[done]
        else:
            found = min((character.found for character in self._characters if character.finder is not None), default=0)
            frame = self._scheduled[min(len(self._scheduled) - self._keyed + found, len(self._scheduled) - 1)]
        saved = Saved(self._plan, self._contents, done, frame, self.poses.text(), [])
        rows = []
        for character in self._characters:
            entry = SavedObject(
                largest_displacement=character.largest_displacement,
                largest_residual=character.largest_residual,
                evaluations=character.evaluations,
                unconverged=sorted(character.unconverged),
                state=character.motion.solver.state(),
            )
            saved.objects.append(entry)
            rows.append((character.offsets[: self._keyed_of(done)], character.offsets[: character.found]))
        try:
            self._cache.save(saved, rows)
            self.saved_frame = frame
        except (OSError, ValueError) as problem:  # a full disk is no reason to stop
            self.problem = str(problem)
            self._cache = None
        self._last_save = time.monotonic()

    def end(self) -> None:
        """All is done: delete the cache."""
        if self._cache is not None:
            self._cache.remove()

    def _take_over(self, saved: Saved) -> bool:
        assert self._cache is not None
        rows = self._cache.read_frames(saved, [character.offsets.shape[1] for character in self._characters])
        keyed = self._keyed_of(saved.done)
        if rows is None:
            return False
        whole: list[tuple[BakedCharacter, SavedObject, NDArray[np.float32], NDArray[np.float32]]] = []
        for character, entry, (simulated, found) in zip(self._characters, saved.objects, rows, strict=True):
            may_be_found = keyed if character.finder is not None else 0
            if entry.state is None or len(simulated) != keyed or len(found) > may_be_found:
                return False
            try:
                character.motion.solver.restore(entry.state)
            except ValueError:
                return False
            whole.append((character, entry, simulated, found))
        for character, entry, simulated, found in whole:
            character.offsets[:keyed] = simulated
            character.offsets[: len(found)] = found
            character.found = len(found)
            character.largest_displacement = entry.largest_displacement
            character.largest_residual = entry.largest_residual
            character.evaluations = entry.evaluations
            character.unconverged = set(entry.unconverged)
        return True

    def _discard(self) -> None:
        assert self._cache is not None
        self._cache.remove()
        self.has_begun_anew = True

    @cached_property
    def _contents(self) -> str:
        return contents_of(character.motion for character in self._characters)

    def _keyed_of(self, done: int) -> int:
        """How many of the first frames of the schedule are keyed."""
        return max(0, done - (len(self._scheduled) - self._keyed))
