# SPDX-License-Identifier: GPL-3.0-or-later
"""What a bake has done so far, on disk, so that it goes on where a crash, a kill or Esc has stopped it.

A cache belongs to some objects of a scene. Its first file, an .npz, says what was baked and how far it came, and holds the
solvers' states; beside it lies a file of finished frames for each object, which only ever grows. The first file is
replaced as a whole after the frames are written, and knows their checksums: whatever happens between leaves a cache
that is whole, or is recognised as broken.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from numpy.typing import NDArray

from followthrough import __version__
from followthrough.character import BonePose, Pose
from followthrough.npz_files import read_npz, write_npz
from followthrough.secondary_motion import SecondaryMotion
from followthrough.solver import SolverState

if TYPE_CHECKING:
    from followthrough.blender.bake import FrameRange, ObjectSettings

#: Of the files; another one is not read.
FORMAT = 1
_HEADER = "header"


@dataclass
class SavedObject:
    """One object's part of a cache.

    Attributes
    ----------
    simulated, found
        Rows of its file of displacements or offsets, and of the one of offsets that were searched for them.
    state
        Of its solver after the last frame; None where it had made none.
    """

    simulated: int = 0
    simulated_checksum: int = 0
    found: int = 0
    found_checksum: int = 0
    largest_displacement: float = 0.0
    largest_residual: float = 0.0
    evaluations: int = 0
    unconverged: list[int] = field(default_factory=list)
    state: SolverState | None = None


@dataclass
class Saved:
    """How far a bake came.

    Attributes
    ----------
    plan, contents
        What it was asked to do (`plan_of`), and with which meshes, rigs, paint, learned springs and weights (`contents_of`).
    done
        Frames that were simulated, also such that are not keyed.
    frame
        The scene's frame at which it goes on.
    poses
        Digest of the poses of those frames and of the next one.
    """

    plan: str
    contents: str
    done: int
    frame: int
    poses: str
    objects: list[SavedObject]


def cache_folder(blend: Path | None = None) -> Path:
    """Where the cache of a .blend lies: beside it, or in the folder for temporary files where it has not been saved or its own folder
    cannot be written to.

    Parameters
    ----------
    blend
        The file; None: the one that is open.
    """
    path = blend or (Path(bpy.data.filepath) if bpy.data.filepath else None)
    if path is None or not os.access(path.absolute().parent, os.W_OK):
        return Path(tempfile.gettempdir()) / "followthrough_cache"
    return path.absolute().parent / f"{path.stem}_followthrough_cache"


def plan_of(scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange) -> str:
    """Digest of what a bake is asked to do, the scene's frame rate included."""
    start, end = frames.ends_in(scene)
    rate = (scene.render.fps, scene.render.fps_base)
    asked = (__version__, sorted(objects.items()), start, end, frames.preroll, frames.cycles, rate)
    return _digest([repr(asked).encode()])


def contents_of(motions: Iterable[SecondaryMotion]) -> str:
    """Digest of all arrays that a simulation is made of, as the volumes have them, and of the emulator's weights."""
    arrays: list[NDArray[Any]] = []
    for motion in motions:
        volume = motion.volume
        rig = volume.surface.rig
        found: list[NDArray[Any]] = [
            volume.surface.rest_positions,
            volume.surface.triangles,
            volume.surface.object_scale,
        ]
        found += [volume.tet_mesh.vertices, volume.tet_mesh.tets, volume.stiffness, volume.mass, volume.pins]
        if rig is not None:
            found += [rig.bone_indices, rig.bone_weights, rig.bone_segments]
        if volume.learned is not None:
            learned = volume.learned
            found += [learned.stiffness, learned.damping, learned.painted_stiffness, np.array(learned.damping_ratio)]
        if motion.weights is not None:  # settings know a path alone
            found.append(np.frombuffer(motion.weights.digest(), dtype=np.uint8))
        arrays += found
    return _digest(part for array in arrays for part in (repr(array.shape).encode(), np.ascontiguousarray(array).data))


class PoseDigest:
    """Of all poses that a bake has come past."""

    def __init__(self) -> None:
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, poses: Sequence[Pose]) -> None:
        """Those of all objects in one frame."""
        for pose in poses:
            local = pose.bone_matrices if isinstance(pose, BonePose) else pose.positions
            self._hash.update(local.tobytes())
            self._hash.update(pose.world.tobytes())

    def text(self) -> str:
        """So far."""
        return self._hash.hexdigest()


class BakeCache:
    """The cache of some objects.

    Parameters
    ----------
    folder
        `cache_folder`; made when there is something to write.
    scene, names
        Whose bake it is.
    """

    def __init__(self, folder: Path, scene: str, names: Iterable[str]) -> None:
        self._folder = folder
        self._stem = _digest([json.dumps([scene, sorted(names)]).encode()])
        self._written: list[SavedObject] = []

    @property
    def path(self) -> Path:
        """The file that says how far it came."""
        return self._folder / f"{self._stem}.npz"

    def load(self) -> Saved | None:
        """What there is, without the frames; None where there is nothing, or nothing that can be used."""
        try:
            arrays = read_npz(self.path)
            header = json.loads(arrays.pop(_HEADER).tobytes())
            if header.pop("format") != FORMAT:
                return None
            objects = []
            for index, entry in enumerate(header.pop("objects")):
                counts = entry.pop("state")
                state = None
                if counts is not None:
                    names = [_array_name(index, part) for part in range(counts["arrays"])]
                    state = SolverState(tuple(arrays[name] for name in names), counts["frames"])
                objects.append(SavedObject(**entry, state=state))
            return Saved(**header, objects=objects)
        except (ValueError, KeyError, TypeError, AttributeError, OSError):
            return None

    def read_frames(
        self, saved: Saved, vertices: Sequence[int]
    ) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]] | None:
        """For every object its simulated rows and its found ones, (rows, v, 3) each; None where they are not what was saved."""
        result = []
        for index, (entry, count) in enumerate(zip(saved.objects, vertices, strict=True)):
            simulated = _read_rows(self._frames(index, "simulated"), entry.simulated, count, entry.simulated_checksum)
            found = _read_rows(self._frames(index, "found"), entry.found, count, entry.found_checksum)
            if simulated is None or found is None:
                return None
            result.append((simulated, found))
        self._written = saved.objects
        return result

    def save(self, saved: Saved, rows: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]]) -> None:
        """Write what has come to it since the last time.

        Parameters
        ----------
        saved
            How far it came; the numbers of rows and checksums are filled in here.
        rows
            Simulated and found rows of every object, from the first one on.

        Raises
        ------
        OSError, ValueError
            Where it cannot be written.
        """
        self._folder.mkdir(exist_ok=True)
        arrays = {}
        entries = []
        before = self._written or [SavedObject() for _ in saved.objects]
        for index, (entry, (simulated, found)) in enumerate(zip(saved.objects, rows, strict=True)):
            last = before[index]
            entry.simulated, entry.found = len(simulated), len(found)
            entry.simulated_checksum = _append_rows(
                self._frames(index, "simulated"), last.simulated, last.simulated_checksum, simulated
            )
            entry.found_checksum = _append_rows(self._frames(index, "found"), last.found, last.found_checksum, found)
            fields = {name: value for name, value in vars(entry).items() if name != "state"}
            parts = () if entry.state is None else entry.state.arrays
            arrays.update({_array_name(index, part): array for part, array in enumerate(parts)})
            counts = None if entry.state is None else {"arrays": len(parts), "frames": entry.state.frames}
            entries.append({**fields, "state": counts})
        header = {"format": FORMAT, **{name: value for name, value in vars(saved).items() if name != "objects"}}
        text = json.dumps({**header, "objects": entries}).encode()
        write_npz(self.path, {_HEADER: np.frombuffer(text, dtype=np.uint8), **arrays}, compressed=False)
        self._written = saved.objects

    def remove(self) -> None:
        """Delete it, and the folder where nothing else is in it."""
        self._written = []
        try:
            for path in self._folder.glob(f"{self._stem}*"):
                path.unlink(missing_ok=True)
            self._folder.rmdir()
        except OSError:
            pass  # not there, not ours to delete, or other caches are in it

    def _frames(self, index: int, kind: str) -> Path:
        return self._folder / f"{self._stem}-{index}.{kind}"


def resumable_frame(
    folder: Path, scene: bpy.types.Scene, objects: Mapping[str, ObjectSettings], frames: FrameRange
) -> int | None:
    """The frame at which a bake of these objects would go on; None where it would begin anew.

    Quick enough for a panel: whether meshes and animation are still the same is left to the bake.
    """
    cache = BakeCache(folder, scene.name, objects)
    path = cache.path
    try:
        stamp = path.stat().st_mtime_ns
    except OSError:
        return None
    if (str(path), stamp) not in _seen:
        _seen.clear()
        saved = cache.load()
        _seen[str(path), stamp] = None if saved is None else (saved.plan, saved.frame)
    known = _seen[str(path), stamp]
    return known[1] if known is not None and known[0] == plan_of(scene, objects, frames) else None


#: What `resumable_frame` has read last, by path and time.
_seen: dict[tuple[str, int], tuple[str, int] | None] = {}


def _array_name(index: int, part: int) -> str:
    return f"state_{index}_{part}"


def _digest(parts: Iterable[Any]) -> str:
    found = hashlib.blake2b(digest_size=16)
    for part in parts:
        found.update(part)
    return found.hexdigest()


def _append_rows(path: Path, count: int, checksum: int, rows: NDArray[np.float32]) -> int:
    """Write the rows after the first `count`, which are there already; returns the checksum of all."""
    if len(rows) == count:
        return checksum
    added = np.ascontiguousarray(rows[count:])
    with path.open("r+b" if count else "wb") as file:
        file.truncate(count * added[0].nbytes)
        file.seek(0, 2)
        file.write(added.data)
    return zlib.crc32(added.data, checksum)


def _read_rows(path: Path, count: int, vertices: int, checksum: int) -> NDArray[np.float32] | None:
    shape = (count, vertices, 3)
    if not count:
        return np.zeros(shape, dtype=np.float32)
    try:
        rows = np.fromfile(path, dtype=np.float32, count=count * vertices * 3)
    except OSError:
        return None
    if rows.size != count * vertices * 3 or zlib.crc32(rows.data) != checksum:
        return None
    return rows.reshape(shape)
