# SPDX-License-Identifier: GPL-3.0-or-later
"""A rigged character's frames, whatever the solver."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from followthrough.character import BonePose, Paint, Rig, Surface
from followthrough.controls import Amplified
from followthrough.elastic import ElasticBody, ImplicitEuler
from followthrough.secondary_motion import RiggedMotion, make_springs
from followthrough.settings import SpringSettings, VolumeSettings
from followthrough.solver import Solver
from followthrough.volume import Volume, build_volume

DT = 1 / 24


@pytest.fixture(scope="module")
def volume() -> Volume:
    """A cube on one bone, its lower half pinned."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)
    segment = np.array([[[0.5, 0.5, 0.0], [0.5, 0.5, 0.4]]])
    rig = Rig(np.zeros((8, 1), dtype=np.int32), np.ones((8, 1)), segment)
    half = np.full(8, 0.5)
    paint = Paint(half, half, np.where(corners[:, 2] < 0.5, 1.0, 0.0))
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
