# SPDX-License-Identifier: GPL-3.0-or-later
"""One character's secondary motion, frame by frame: pose in, shape key offsets out. Preview, bake and command line all drive this."""

from __future__ import annotations

import concurrent.futures
import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from followthrough import _core
from followthrough.character import BonePose, FloatArray, LearnedSprings, Paint, Pose, Surface
from followthrough.controls import Amplified
from followthrough.emulated_flesh import caution, load_weights, make_emulated_flesh
from followthrough.flesh import loose_vertices, make_flesh
from followthrough.mesh import TetMesh
from followthrough.settings import Settings, SpringSettings
from followthrough.solver import Solver
from followthrough.springs import Springs
from followthrough.volume import Volume, build_volume


@dataclass(frozen=True)
class Frame:
    """Result of one frame.

    Attributes
    ----------
    offsets : (v, 3) float64 or None
        What to add to the mesh's rest vertices, in its object space, so that the rig moves them to where the motion wants them.
        None where something else than a rig moves the mesh: whoever can evaluate it finds them (`followthrough.offset_search`).
    displacements : (v, 3) float64 or None
        The secondary motion itself, in the world, metres. None where the frame was written elsewhere (`SecondaryMotion.begin`).
    largest_displacement : float
        Metres.
    largest_residual : float
        Largest part of a displacement that no offset can reach because the rig flattens the skin there, metres; 0 where the
        offsets are not found here.
    converged : bool
        False where the solver could not take the step as exactly as its quality asks for.
    """

    offsets: FloatArray | None
    displacements: FloatArray | None
    largest_displacement: float
    largest_residual: float
    converged: bool = True


def make_solver(volume: Volume, settings: Settings, dt: float) -> Solver:
    """The solver that the settings ask for, on the volume's vertices, with painted constants.

    Raises
    ------
    ValueError
        Where it cannot be made for this volume.
    """
    solver: Solver
    if settings.solver == "implicit-euler":
        solver = make_flesh(volume, settings.simulation, dt)
    elif settings.solver == "emulator":
        solver = make_emulated_flesh(volume, settings.simulation, settings.emulator, dt)
    else:
        solver = make_springs(volume, settings.springs, dt)
    return solver if settings.amplitude == 1.0 else Amplified(solver, settings.amplitude)


def make_springs(volume: Volume, settings: SpringSettings, dt: float) -> Springs:
    """Springs on the volume's vertices, with learned constants where there are any, and painted ones elsewhere.

    A soft pin p strengthens a painted spring to ks / (1 - p) at the same damping ratio; a learned one has felt the pins already.
    """
    low, high = settings.stiffness_range
    mass = _mass(volume.mass, settings)
    unit_stiffness = low ** (1.0 - volume.stiffness) * high**volume.stiffness
    unit_damping = (
        2.0 * settings.damping_ratio * np.sqrt(unit_stiffness) if settings.damping is None else settings.damping
    )
    free = 1.0 - np.where(volume.pinned, 0.0, volume.pins)
    stiffness, damping = unit_stiffness / mass / free, unit_damping / mass / np.sqrt(free)
    if volume.learned is not None and settings.use_learned:
        stiffness, damping = _with_learned(volume.learned, unit_stiffness / mass, stiffness, damping, settings)
    return Springs(
        stiffness=stiffness,
        damping=damping,
        dt=dt,
        pinned=volume.pinned,
        gravity=(0.0, 0.0, -settings.gravity * volume.surface.size),
    )


def painted_stiffness(stiffness: FloatArray, mass: FloatArray, settings: SpringSettings) -> FloatArray:
    """ks (n,), 1/s², of springs where stiffness and mass are painted so, without pins."""
    low, high = settings.stiffness_range
    values: FloatArray = low ** (1.0 - stiffness) * high**stiffness / _mass(mass, settings)
    return values


def _mass(painted: FloatArray | float, settings: SpringSettings) -> FloatArray:
    light, heavy = settings.mass_range
    factor: FloatArray = np.asarray(light ** (1.0 - painted) * heavy**painted)
    return factor


def _with_learned(
    learned: LearnedSprings, painted: FloatArray, stiffness: FloatArray, damping: FloatArray, settings: SpringSettings
) -> tuple[FloatArray, FloatArray]:
    """Learned constants in the place of others where there are some; `painted` is what paint and settings say now."""
    known = learned.known
    faster = np.ones(len(known))
    calmer = 1.0
    if settings.scale_learned:
        faster[known] = painted[known] / learned.painted_stiffness[known]
        if settings.damping is None:
            usual = SpringSettings().damping_ratio
            before, now = learned.damping_ratio, settings.damping_ratio
            calmer = now / before if before > 0 else 1.0 + now / usual
    scaled = np.where(known, learned.damping * np.sqrt(faster) * calmer, damping)
    if settings.damping is not None and settings.scale_learned:
        scaled = damping  # one damping for all, as it is asked for
    return np.where(known, learned.stiffness * faster, stiffness), scaled


class RiggedMotion:
    """The frames of a character that bones move, in one native pass (`cpp/include/followthrough/motion`)."""

    def __init__(self, volume: Volume, solver: Solver, minimum_stretch: float) -> None:
        rig = volume.surface.rig
        if rig is None or volume.bone_indices is None or volume.bone_weights is None:
            raise ValueError("volume: found none of a rigged character, expected one that was made with a rig")
        self._bone_count = len(rig.bone_segments)
        self._solver = solver
        self._ahead: tuple[Pose, Any] | None = None
        rest_matrices = np.zeros((0, 16)) if rig.bone_rest_matrices is None else _matrices(rig.bone_rest_matrices)
        self._core = _core.RiggedMotion(
            volume.rest_positions,
            volume.bone_indices,
            volume.bone_weights,
            volume.tet_mesh.tets,
            volume.tet_mesh.embedding_tets,
            volume.tet_mesh.embedding_weights,
            rig.bone_indices,
            rig.bone_weights,
            rest_matrices,
            rig.skinning == "dual-quaternion",
            minimum_stretch,
            solver.core,
            # Springs leave the other cores to Blender, which works on the next pose meanwhile.
            1 if solver.is_quick else 0,
        )

    def reset(self, pose: Pose) -> None:
        """Start over."""
        self._core.reset(self._pose(pose))

    def step(self, pose: Pose, next_pose: Pose | None) -> Frame:
        """Take one frame."""
        return self._frame(self._core.step(*self._poses(pose, next_pose)))

    def reference(self, pose: Pose) -> FloatArray:
        """Where the rig alone puts the volume's vertices, (n, 3) in the world, metres: what the solver is given."""
        reference: FloatArray = self._core.reference(self._pose(pose))
        return reference

    def begin(self, pose: Pose, next_pose: Pose | None, into: NDArray[np.float32] | None) -> None:
        """Start a frame on the core's own thread, after those that are under way there."""
        self._core.begin(*self._poses(pose, next_pose), into)

    def wait(self, seconds: float) -> bool:
        """Wait for the oldest one, so long at most; whether `finish` would no longer wait."""
        done: bool = self._core.wait(seconds)
        return done

    def finish(self) -> Frame:
        """Wait for the oldest one."""
        return self._frame(self._core.finish())

    def abandon(self) -> None:
        """Drop all that are under way, once what has been started of them has ended."""
        self._core.abandon()

    def _frame(self, result: tuple[FloatArray, FloatArray, float, float]) -> Frame:
        offsets, displacements, largest_displacement, largest_residual = result
        written = not len(displacements)
        return Frame(
            None if written else offsets,
            None if written else displacements,
            largest_displacement,
            largest_residual,
            converged=self._solver.converged,
        )

    def _poses(self, pose: Pose, next_pose: Pose | None) -> tuple[Any, Any]:
        """Both for the core; the pose ahead is the next call's pose."""
        here = self._ahead[1] if self._ahead is not None and self._ahead[0] is pose else self._pose(pose)
        self._ahead = None if next_pose is None else (next_pose, self._pose(next_pose))
        return here, None if self._ahead is None else self._ahead[1]

    def _pose(self, pose: Pose) -> Any:
        if not isinstance(pose, BonePose):
            raise ValueError("pose: found sampled positions, but this character has a rig; expected a BonePose")
        if pose.bone_matrices.shape != (self._bone_count, 4, 4):
            raise ValueError(
                f"pose.bone_matrices: found shape {pose.bone_matrices.shape}, expected ({self._bone_count}, 4, 4)"
            )
        armature = np.eye(4) if pose.armature is None else pose.armature
        return _core.RigPose(_matrices(pose.bone_matrices), armature, pose.world)


def _matrices(matrices: FloatArray) -> FloatArray:
    return np.ascontiguousarray(matrices, dtype=np.float64).reshape(-1, 16)


class SecondaryMotion:
    """Drives one solver with a character's poses.

    `caution` is a sentence for the artist where the solver is asked for more than it can do (`emulated_flesh.caution`), or empty;
    `weights` are the emulator's, None for other solvers.

    Parameters
    ----------
    surface, paint
        The character.
    settings
        Volume and solver.
    dt
        Seconds a frame.
    tet_mesh
        As in `build_volume`.

    Raises
    ------
    ValueError
        Where the arrays do not fit each other, or the solver cannot be made for them.
    """

    def __init__(
        self, surface: Surface, paint: Paint, settings: Settings, dt: float, tet_mesh: TetMesh | None = None
    ) -> None:
        if not (np.isfinite(dt) and dt > 0):
            raise ValueError(f"dt: found {dt:g}, expected a positive number of seconds")
        self.settings = settings
        self.volume = build_volume(surface, paint, settings.volume, tet_mesh)
        self.weights = load_weights(settings.emulator) if settings.solver == "emulator" else None
        self.solver = make_solver(self.volume, settings, dt)
        self.caution = caution(surface, paint, settings, dt, self.volume.tet_mesh)
        self._rigged = None if surface.rig is None else RiggedMotion(self.volume, self.solver, settings.minimum_stretch)
        self._ahead: tuple[Pose, FloatArray] | None = None
        self._threads: concurrent.futures.ThreadPoolExecutor | None = None
        self._begun: deque[concurrent.futures.Future[Frame]] = deque()
        self._under_way = 0

    @property
    def loose_vertex_count(self) -> int:
        """Vertices of the surface in parts that no pin holds, where the solver needs one: they follow the reference."""
        if self.settings.solver == "springs":
            return 0
        tet_mesh = self.volume.tet_mesh
        return int(loose_vertices(self.volume)[tet_mesh.tets[tet_mesh.embedding_tets, 0]].sum())

    @property
    def is_quick(self) -> bool:
        """Whether frames are so short, and their poses so small, that many of them had better be under way at once."""
        return self._rigged is not None and self.solver.is_quick

    def reset(self, pose: Pose) -> Frame:
        """Start over in this pose, without secondary motion."""
        if self._rigged is not None:
            self._rigged.reset(pose)
        else:
            self._ahead = None
            self.solver.reset(self.volume.reference(pose))
        nothing = np.zeros_like(self.volume.surface.rest_positions)
        offsets = nothing if self._rigged is not None else None
        return Frame(offsets=offsets, displacements=nothing, largest_displacement=0.0, largest_residual=0.0)

    def step(self, pose: Pose, next_pose: Pose | None = None) -> Frame:
        """Take one frame to this pose; `next_pose`, where it is known, makes the target's motion smooth at this frame.

        Raises
        ------
        ValueError
            Where the pose is not of this character or not finite, or the motion no longer is.
        """
        if self._rigged is not None:
            return self._rigged.step(pose, next_pose)
        return self._sampled_step(pose, next_pose)

    def begin(self, pose: Pose, next_pose: Pose | None = None, into: NDArray[np.float32] | None = None) -> None:
        """Start `step` on a thread of its own, while the caller reads the next poses. `finish` or `abandon` must follow.

        Several frames may be under way at once; they are taken in the order in which they begin.

        Parameters
        ----------
        pose, next_pose
            As for `step`.
        into : (v, 3) float32, optional
            Takes, in rows without gaps, the offsets (the displacements where something else than a rig moves the mesh) in place of the
            frame's arrays, which are then None. Where they are more than single precision holds, the frame is an error.
        """
        if self._rigged is not None:
            self._rigged.begin(pose, next_pose, into)
        else:
            if self._threads is None:
                self._threads = concurrent.futures.ThreadPoolExecutor(max_workers=1)
            self._begun.append(self._threads.submit(self._sampled_step, pose, next_pose, into))
        self._under_way += 1

    def wait(self, seconds: float) -> bool:
        """Wait for the oldest frame under way, so long at most; whether `finish` would no longer wait."""
        if self._rigged is not None:
            return self._rigged.wait(seconds)
        return not self._begun or bool(concurrent.futures.wait([self._begun[0]], seconds).done)

    def finish(self) -> Frame:
        """Wait for the oldest frame that `begin` started: the same, to the bit, that `step` returns.

        Raises
        ------
        ValueError
            As `step`. The frames that were begun later are then dropped.
        """
        if not self._under_way:
            raise ValueError("pose: found no frame under way, expected begin to be called first")
        try:
            frame = self._begun.popleft().result() if self._rigged is None else self._rigged.finish()
        except BaseException:
            self._drop()
            raise
        self._under_way -= 1
        return frame

    def abandon(self) -> None:
        """Leave the frames under way to themselves, if there are any: nothing waits for their end, and nobody sees them. The motion is over
        then.
        """
        if self._under_way:
            self._under_way = 0
            # The thread keeps all that a frame needs for as long as it needs it.
            threading.Thread(target=self._drop).start()

    def _drop(self) -> None:
        """Drop all frames under way, and wait for what has been started of them."""
        self._under_way = 0
        if self._rigged is not None:
            self._rigged.abandon()
        for begun in self._begun:
            begun.cancel()
        concurrent.futures.wait(self._begun)
        self._begun.clear()

    def _sampled_step(self, pose: Pose, next_pose: Pose | None, into: NDArray[np.float32] | None = None) -> Frame:
        if isinstance(pose, BonePose):
            raise ValueError("pose: found bone matrices, but this character has no rig; expected a SampledPose")
        known = self._ahead is not None and self._ahead[0] is pose
        reference = self._ahead[1] if known and self._ahead is not None else self.volume.reference(pose)
        self._ahead = None if next_pose is None else (next_pose, self.volume.reference(next_pose))
        dynamic = self.solver.step(reference, None if self._ahead is None else self._ahead[1])
        displacements = self.volume.surface_displacements(dynamic, reference)
        longest = _longest(displacements)
        if into is None:
            return Frame(None, displacements, longest, 0.0, self.solver.converged)
        with np.errstate(over="ignore"):  # told below
            np.copyto(into, displacements, casting="same_kind")
        if not np.isfinite(into).all():
            raise ValueError("the motion is no longer finite")
        return Frame(None, None, longest, 0.0, self.solver.converged)


def _longest(vectors: FloatArray) -> float:
    """Length of the longest of (n, 3)."""
    return float(np.sqrt(np.einsum("ij,ij->i", vectors, vectors).max(initial=0.0)))
