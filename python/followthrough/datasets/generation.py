# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a data set: simulates every sequence of a recipe into a folder, in several processes, from where it was left off."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from followthrough.datasets.manifest import FILE_NAME, Entry, Manifest, file_hash
from followthrough.datasets.recipes import Item, Recipe
from followthrough.datasets.truth import simulate_truth
from followthrough.datasets.workers import run_all
from followthrough.sequences import Sequence

Precision = Literal["float32", "float64"]
PRECISIONS: tuple[Precision, ...] = ("float32", "float64")
#: A sequence that converged for fewer frames is not kept.
LEAST_FRAMES = 10


@dataclass(frozen=True)
class Summary:
    """What became of a data set.

    Attributes
    ----------
    manifest : Manifest
        As it is in the folder now.
    kept : int
        Sequences that were there already.
    made : int
        Sequences that were simulated.
    """

    manifest: Manifest
    kept: int
    made: int

    @property
    def stopped(self) -> list[str]:
        """Names of sequences that end early, or have no file, because a step did not converge."""
        return sorted(name for name, entry in self.manifest.files.items() if entry.stopped_at is not None)


@dataclass(frozen=True)
class Production:
    """Makes one file of a data set; sent to other processes.

    Parameters
    ----------
    recipe
        What the sequences are.
    directory
        Where they go.
    precision
        Of positions in the files. With "float32" the sequence is rounded before it is simulated, so that the file's
        reference is exactly what was simulated, and only `dynamic` is rounded after.
    """

    recipe: Recipe
    directory: Path
    precision: Precision

    def __call__(self, item: Item, frame_done: Callable[[], None]) -> Entry:
        """Simulate a sequence and write its file."""
        truth = simulate_truth(_rounded(self.recipe.make(item), self.precision), frame_done)
        path = self.directory / item.name
        for _ in range(truth.sequence.frame_count, item.frames):
            frame_done()  # those that will not come
        kept = truth.stopped_at is None or truth.stopped_at >= min(LEAST_FRAMES, item.frames)
        if kept:
            truth.sequence.save(path, self.precision)
        else:
            path.unlink(missing_ok=True)
        return Entry(
            motion=item.motion,
            frames=truth.sequence.frame_count if kept else 0,
            sha256=file_hash(path) if kept else None,
            size=path.stat().st_size if kept else 0,
            worst_residual=truth.worst_residual,
            tried_again=list(truth.tried_again),
            stopped_at=truth.stopped_at,
            stopped_residual=truth.stopped_residual,
            facts=dict(item.facts),
        )


def generate(
    recipe: Recipe,
    directory: Path | str,
    motions: int,
    *,
    precision: Precision = "float32",
    jobs: int | None = None,
    begin: Callable[[int, int], None] = lambda frames, kept: None,
    frames_done: Callable[[int], None] = lambda frames: None,
) -> Summary:
    """Make a data set, or finish one that was begun.

    Files are the same bytes whatever the number of processes and however often it was interrupted. What is finished is
    verified by its hash and kept; what is missing or damaged is made again. With more motions than before, the files that
    are there stay as they are; fewer motions take nothing away.

    Parameters
    ----------
    recipe
        What its sequences are.
    directory
        The folder, made where it is missing.
    motions
        How many, 1 or more.
    precision
        What positions are stored in. float32 keeps them to 6e-8 of their distance from the origin in half the space.
    jobs
        Processes, each on one thread; None: one a core. 1 stays in this process.
    begin
        Called once, with the number of frames to simulate and of sequences that are there already.
    frames_done
        Called now and then with the number of frames done since the last call.

    Returns
    -------
    Summary

    Raises
    ------
    ValueError
        Where the folder holds something else.
    KeyboardInterrupt
        When interrupted; what is finished stays, and nothing is half-written.
    """
    if motions < 1:
        raise ValueError(f"motions: found {motions}, expected 1 or more")
    if precision not in PRECISIONS:
        raise ValueError(f"precision: found {precision!r}, expected {' or '.join(PRECISIONS)}")
    if jobs is not None and jobs < 1:
        raise ValueError(f"jobs: found {jobs}, expected 1 or more")
    directory = Path(directory)
    manifest = _open(recipe, directory, precision, motions)
    items = recipe.items(manifest.motions)
    intact = manifest.intact(directory, (item.name for item in items))
    manifest.files = {item.name: manifest.files[item.name] for item in items if item.name in intact}
    manifest.save(directory)
    missing = [item for item in items if item.name not in intact]
    begin(sum(item.frames for item in missing), len(intact))

    def finished(item: Item, entry: Entry) -> None:
        manifest.files[item.name] = entry
        manifest.save(directory)

    run_all(
        Production(recipe, directory.resolve(), precision),
        missing,
        jobs=min(jobs or _cores(), max(len(missing), 1)),
        finished=finished,
        frames_done=frames_done,
    )
    return Summary(manifest, len(intact), len(missing))


def _open(recipe: Recipe, directory: Path, precision: Precision, motions: int) -> Manifest:
    """The manifest of a folder, begun where the folder is empty; leftovers of a killed run are removed."""
    if directory.exists() and not directory.is_dir():
        raise ValueError(f"{directory}: found a file, expected a folder")
    directory.mkdir(exist_ok=True)  # not its parents: a typing error should not make a tree
    manifest = Manifest.begin(recipe, precision, motions)
    if (directory / FILE_NAME).exists():
        found = Manifest.load(directory)
        found.require_same(manifest, directory)
        found.motions = max(found.motions, motions)
        manifest = found
    ours = {item.name.removesuffix(".npz") for item in recipe.items(manifest.motions)} | {"manifest"}
    for path in directory.iterdir():
        if path.name.startswith(".") and path.name[1:].rpartition("-")[0] in ours:
            path.unlink()
        elif not (directory / FILE_NAME).exists() and not path.name.startswith("."):
            raise ValueError(f"{directory}: found {path.name} and no manifest, expected an empty folder or a data set")
    return manifest


def _rounded(sequence: Sequence, precision: Precision) -> Sequence:
    if precision == "float64":
        return sequence
    rest, reference = (
        array.astype(np.float32).astype(np.float64) for array in (sequence.rest_positions, sequence.reference)
    )
    return replace(sequence, rest_positions=rest, reference=reference)


def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1
