# SPDX-License-Identifier: GPL-3.0-or-later
"""A rigged character's frames, whatever the solver."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough.character import BonePose, Paint, Pose, Rig, SampledPose, Surface
from followthrough.controls import Amplified
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.secondary_motion import RiggedMotion, SecondaryMotion, make_springs
from followthrough.settings import Settings, SpringSettings, VolumeSettings
from followthrough.solver import Solver
from followthrough.volume import Volume, build_volume

DT = 1 / 24


def cube() -> tuple[NDArray[np.float64], NDArray[np.int32], Rig, Paint]:
    """A cube on one bone, its lower half pinned: corners, triangles, rig and paint."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    segment = np.array([[[0.5, 0.5, 0.0], [0.5, 0.5, 0.4]]])
    rig = Rig(np.zeros((8, 1), dtype=np.int32), np.ones((8, 1)), segment)
    half = np.full(8, 0.5)
    paint = Paint(half, half, np.where(corners[:, 2] < 0.5, 1.0, 0.0))
    return corners, triangles, rig, paint


@pytest.fixture(scope="module")
def volume() -> Volume:
    corners, triangles, rig, paint = cube()
    return build_volume(Surface(corners, triangles, rig=rig), paint, VolumeSettings(cells=4))


def poses() -> list[BonePose]:
    result = []
    for frame in range(6):
        angle = 0.3 * math.sin(frame)
        matrix = np.eye(4)
        matrix[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
        matrix[:3, 3] = [0.1 * frame, 0.05 * (frame % 2), 0.0]
        result.append(BonePose(matrix[None], np.eye(4)))
    return result


def solvers(volume: Volume) -> dict[str, Solver]:
    body = ElasticBody(volume.tet_mesh.vertices, volume.tet_mesh.tets, 5e4)
    return {
        "springs": make_springs(volume, SpringSettings(), DT),
        "implicit-euler": ImplicitEuler(body, volume.pinned, DT),
    }


@pytest.mark.parametrize("name", ["springs", "implicit-euler"])
def test_the_native_pass_drives_any_solver(volume: Volume, name: str) -> None:
    native, alone = solvers(volume)[name], solvers(volume)[name]
    motion = RiggedMotion(volume, native, 0.05)
    frames = poses()
    motion.reset(frames[0])
    references: list[NDArray[np.float64]] = [volume.reference(pose) for pose in frames]
    alone.reset(references[0])
    for frame in range(1, len(frames) - 1):
        made = motion.step(frames[frame], frames[frame + 1])
        moved = alone.step(references[frame], references[frame + 1])
        expected = volume.surface_displacements(moved, references[frame])
        np.testing.assert_allclose(made.displacements, expected, rtol=0, atol=1e-10)
        np.testing.assert_allclose(
            made.offsets @ frames[frame].bone_matrices[0, :3, :3].T, expected, rtol=0, atol=1e-10
        )
    assert made.largest_displacement > 1e-3


def characters() -> dict[str, tuple[SecondaryMotion, list[Pose]]]:
    """The same cube on its bone, and moved by something else."""
    corners, triangles, rig, paint = cube()
    settings = Settings(solver="springs", volume=VolumeSettings(cells=4))
    rigged, bare = Surface(corners, triangles, rig=rig), Surface(corners, triangles)
    sampled: list[Pose] = [
        SampledPose(corners @ pose.bone_matrices[0, :3, :3].T + pose.bone_matrices[0, :3, 3], pose.world)
        for pose in poses()
    ]
    return {
        "rigged": (SecondaryMotion(rigged, paint, settings, DT), [*poses()]),
        "sampled": (SecondaryMotion(bare, paint, settings, DT), sampled),
    }


def test_frames_are_quick_where_springs_follow_a_rig() -> None:
    assert characters()["rigged"][0].is_quick
    assert not characters()["sampled"][0].is_quick
    corners, triangles, rig, paint = cube()
    flesh = Settings(solver="implicit-euler", volume=VolumeSettings(cells=4))
    assert not SecondaryMotion(Surface(corners, triangles, rig=rig), paint, flesh, DT).is_quick


@pytest.mark.parametrize("name", ["rigged", "sampled"])
def test_frames_under_way_are_written_as_single_precision_in_their_order(name: str) -> None:
    plain, frames = characters()[name]
    motion, _ = characters()[name]
    plain.reset(frames[0])
    motion.reset(frames[0])
    following = [*frames[2:], None]
    into = np.full((len(following), 8, 3), np.nan, dtype=np.float32)
    for row, pose, after in zip(into, frames[1:], following, strict=True):
        motion.begin(pose, after, row)
    for row, pose, after in zip(into, frames[1:], following, strict=True):
        step = plain.step(pose, after)
        found = motion.finish()
        wanted = step.displacements if step.offsets is None else step.offsets
        assert wanted is not None
        np.testing.assert_array_equal(row, wanted.astype(np.float32))
        assert found == replace(step, offsets=None, displacements=None)
    assert np.abs(into).max() > 1e-3
    with pytest.raises(ValueError, match="no frame under way"):
        motion.finish()


@pytest.mark.parametrize("name", ["rigged", "sampled"])
def test_a_frame_that_fails_drops_those_that_follow(name: str) -> None:
    motion, frames = characters()[name]
    motion.reset(frames[0])
    motion.begin(frames[1])
    motion.begin(replace(frames[2], world=np.full((4, 4), np.nan)))
    motion.begin(frames[3])
    motion.finish()
    with pytest.raises(ValueError, match=r"pose|reference"):
        motion.finish()
    with pytest.raises(ValueError, match="no frame under way"):
        motion.finish()
    motion.reset(frames[0])
    motion.begin(frames[1], frames[2])
    assert motion.finish().largest_displacement > 0


@pytest.mark.parametrize("name", ["rigged", "sampled"])
def test_more_than_single_precision_holds_is_an_error(name: str) -> None:
    motion, frames = characters()[name]
    far = np.eye(4)
    far[0, 3] = 1e100
    motion.reset(frames[0])
    motion.step(replace(frames[1], world=far))
    row = np.empty((8, 3), dtype=np.float32)
    motion.begin(frames[2], None, row)
    with pytest.raises(ValueError, match="no longer finite"):
        motion.finish()


@pytest.mark.parametrize("shape", [(7, 3), (8, 2), (24,)])
def test_rows_that_do_not_fit_are_refused(shape: tuple[int, ...]) -> None:
    motion, frames = characters()["rigged"]
    motion.reset(frames[0])
    with pytest.raises(ValueError, match="offsets"):
        motion.begin(frames[1], None, np.empty(shape, dtype=np.float32))
    with pytest.raises(TypeError):
        motion.begin(frames[1], None, np.empty((8, 3)))
    with pytest.raises(TypeError):
        motion.begin(frames[1], None, np.empty((16, 3), dtype=np.float32)[::2])
    motion.begin(frames[1], None, np.empty((8, 3), dtype=np.float32))
    motion.finish()


@pytest.mark.parametrize("name", ["rigged", "sampled"])
def test_what_is_abandoned_ends_by_itself(name: str) -> None:
    motion, frames = characters()[name]
    motion.reset(frames[0])
    for _ in range(50):
        motion.begin(frames[1], frames[2], np.empty((8, 3), dtype=np.float32))
    motion.abandon()
    motion.abandon()
    with pytest.raises(ValueError, match="no frame under way"):
        motion.finish()


@pytest.mark.parametrize("size", [1.0, 100.0])
def test_springs_sag_by_their_weight_over_their_stiffness(volume: Volume, size: float) -> None:
    large = replace(volume, surface=replace(volume.surface, character_size=size), mass=np.full_like(volume.mass, 0.75))
    springs = make_springs(large, SpringSettings(stiffness_range=(400.0, 400.0), gravity=2.0, damping_ratio=1.0), DT)
    reference = size * volume.tet_mesh.vertices
    springs.reset(reference)
    for _ in range(100):
        positions = springs.step(reference, reference)
    sag = (positions - reference) / size
    # Twice the mass on the same spring sags twice as far; a soft pin of p leaves 1 - p.
    assert sag[:, 2] == pytest.approx(-2.0 * 2.0 / 400.0 * (1.0 - volume.pins), rel=1e-6)
    assert not sag[volume.pinned].any() and not np.abs(sag[:, :2]).max() > 1e-12


def test_springs_leave_the_other_cores_to_their_caller_and_flesh_does_not(volume: Volume) -> None:
    for name, solver in solvers(volume).items():
        assert solver.is_quick == Amplified(solver, 2.0).is_quick == (name == "springs")
