# SPDX-License-Identifier: GPL-3.0-or-later
"""Offsets are found for any deformation that can be evaluated: bent, kinked, smoothed or flat."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from followthrough.character import FloatArray
from followthrough.offset_search import MOST_EVALUATIONS, Deform, OffsetSearch

COUNT = 500
TOLERANCE = 1e-5
ANGLES = np.linspace(0.0, 20.0 * np.pi, COUNT)
REST = np.column_stack([np.linspace(-0.5, 0.5, COUNT), 0.2 * np.cos(ANGLES), 0.2 * np.sin(ANGLES)])


def rotated(points: FloatArray, angles: FloatArray | float) -> FloatArray:
    """Turned about z."""
    x, y, z = points.T
    return np.column_stack([np.cos(angles) * x - np.sin(angles) * y, np.sin(angles) * x + np.cos(angles) * y, z])


def rounded(points: FloatArray) -> FloatArray:
    """As Blender gives them."""
    return points.astype(np.float32).astype(np.float64)


def twist(time: float) -> Deform:
    return lambda offsets: rounded(rotated(REST + offsets, 2.0 * (REST + offsets)[:, 2] + time))


def kinked(time: float) -> Deform:
    """Like bendy bones: the rotation is mixed linearly between segments."""

    def deform(offsets: FloatArray) -> FloatArray:
        points = REST + offsets
        along = np.clip((points[:, 0] + 0.5) * 5.0, 0.0, 5.0)
        segment = np.minimum(np.floor(along), 4.0)
        share = (along - segment)[:, None]
        first, second = rotated(points, time + 0.2 * segment), rotated(points, time + 0.2 * (segment + 1.0))
        return rounded((1.0 - share) * first + share * second)

    return deform


def smoothed(time: float) -> Deform:
    """Vertices pull at their neighbours."""

    def deform(offsets: FloatArray) -> FloatArray:
        points = rotated(REST + offsets, time)
        for _ in range(3):
            around = np.pad(points, ((1, 1), (0, 0)), mode="edge")
            points = 0.5 * points + 0.25 * (around[2:] + around[:-2])
        return rounded(points)

    return deform


def displacements(frame: int, length: float) -> FloatArray:
    x, y, z = REST.T
    waves = [np.sin(1.3 * frame + 2 * z), np.cos(0.9 * frame + 2 * x), np.sin(0.7 * frame + y)]
    return length * np.column_stack(waves)


@pytest.mark.parametrize("length", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("motion", [twist, kinked])
def test_what_is_shown_is_what_was_wanted(motion: Callable[[float], Deform], length: float) -> None:
    search = OffsetSearch(COUNT, TOLERANCE, probe=2e-3)
    for frame in range(6):
        deform, wanted = motion(0.1 * frame), displacements(frame, length)
        found = search.find(deform, wanted)
        shown = deform(found.offsets) - deform(np.zeros_like(REST))
        np.testing.assert_allclose(found.residuals, wanted - shown, atol=1e-12)
        assert np.linalg.norm(found.residuals, axis=1).max() < TOLERANCE
        assert found.evaluations <= 14


def test_vertices_that_pull_at_each_other() -> None:
    search = OffsetSearch(COUNT, 1e-4, probe=2e-3)
    for frame in range(4):
        deform, wanted = smoothed(0.1 * frame), displacements(frame, 0.1)
        found = search.find(deform, wanted)
        shown = deform(found.offsets) - deform(np.zeros_like(REST))
        assert np.linalg.norm(wanted - shown, axis=1).max() < 3e-4


def test_coupling_that_begins_later_is_noticed() -> None:
    search = OffsetSearch(COUNT, 1e-4, probe=2e-3)
    search.find(twist(0.0), displacements(0, 0.1))
    deform, wanted = smoothed(0.1), displacements(1, 0.1)
    found = search.find(deform, wanted)
    shown = deform(found.offsets) - deform(np.zeros_like(REST))
    np.testing.assert_allclose(found.residuals, wanted - shown, atol=1e-12)
    assert np.linalg.norm(found.residuals, axis=1).max() < 1e-3


def test_what_is_flat_stays_in_the_residual() -> None:
    """Offsets stay bounded, and the directions that can be shown are shown."""
    flat = np.array([1.0, 1.0, 1e-4])
    search = OffsetSearch(COUNT, TOLERANCE, probe=2e-3, minimum_stretch=0.05)
    wanted = displacements(1, 0.1)
    found = search.find(lambda offsets: (REST + offsets) * flat, wanted)
    np.testing.assert_allclose(found.residuals[:, :2], 0.0, atol=TOLERANCE)
    np.testing.assert_allclose(found.residuals[:, 2], wanted[:, 2], atol=2e-3 * 0.1)
    assert np.linalg.norm(found.offsets, axis=1).max() < np.linalg.norm(wanted, axis=1).max() / 0.05


def test_what_cannot_be_reached_does_not_cost_more_and_more() -> None:
    """A deformation that ends at a wall."""
    search = OffsetSearch(COUNT, TOLERANCE, probe=2e-3)

    def wall(offsets: FloatArray) -> FloatArray:
        return np.minimum(REST + offsets, 0.55)

    wanted = np.tile([0.2, 0.0, 0.0], (COUNT, 1))
    found = search.find(wall, wanted)
    assert found.evaluations <= MOST_EVALUATIONS + 1
    short = np.maximum(0.0, REST[:, 0] + 0.2 - 0.55)
    np.testing.assert_allclose(found.residuals[:, 0], short, atol=TOLERANCE)


def test_still_vertices_get_no_offset() -> None:
    search = OffsetSearch(COUNT, TOLERANCE, probe=2e-3)
    wanted = displacements(1, 0.1)
    wanted[::3] = 0.0
    found = search.find(twist(0.3), wanted)
    assert not found.offsets[::3].any()
    assert not search.find(twist(0.4), np.zeros_like(wanted)).offsets.any()


def test_a_number_that_is_not_finite_is_refused() -> None:
    search = OffsetSearch(COUNT, TOLERANCE, probe=2e-3)
    with pytest.raises(ValueError, match="not finite"):
        search.find(lambda offsets: np.full_like(offsets, np.nan), displacements(1, 0.1))
