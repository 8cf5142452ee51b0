# SPDX-License-Identifier: GPL-3.0-or-later
"""Teleports, flips, collapse and bodies turned inside out: results stay finite and sane, and what has not converged says so.

Central differences are left out: they explode as they must.
"""

from collections.abc import Iterator

import numpy as np
import pytest
from elastic_scenes import DT, Array, bar, violent
from numpy.typing import NDArray

from followthrough.elastic import MATERIALS, QUALITIES, ElasticBody, ImplicitEuler, MaterialName, Quality, StepReport
from followthrough.quasistatic import Quasistatic


def scenes(material: MaterialName) -> Iterator[tuple[Array, ElasticBody, NDArray[np.bool_]]]:
    """Bodies from soft to stiff, held at an end and at a single vertex."""
    for cells in ((2, 1, 1), (2, 2, 1)):
        rest, tets = bar(*cells)
        body = ElasticBody(rest, tets, np.geomspace(1e3, 1e7, len(rest)), material=material)
        yield rest, body, rest[:, 0] < 0.1
        yield rest, body, np.arange(len(rest)) == 5


def check(x: Array, reference: Array, held: NDArray[np.bool_], report: StepReport, tolerance: float) -> None:
    assert np.isfinite(x).all()
    np.testing.assert_array_equal(x[held], reference[held])
    assert np.isfinite(report.residual)
    assert report.converged == (report.residual <= tolerance)


def mistreat_implicit_euler(material: MaterialName, quality: Quality, frames: int, burst: int) -> None:
    """Bursts of violence, each from an inverted start and followed by peace."""
    tolerance = {"preview": 5e-2, "fine": 1e-2, "converged": 1e-9}[quality]
    done = seed = 0
    while done < frames:
        seed += 1
        for rest, body, held in scenes(material):
            solver = ImplicitEuler(body, held, DT, quality=quality)
            motion = violent(rest, burst, seed)
            solver.reset(next(motion))
            farthest = 1.0  # m: a body that springs back from collapse overshoots itself
            for reference in motion:
                x = solver.step(reference)
                check(x, reference, held, solver.last_step, tolerance)
                farthest = max(farthest, np.abs(reference).max())
                assert np.abs(x).max() < 2 * farthest
            for _ in range(40):
                x = solver.step(rest)
                check(x, rest, held, solver.last_step, tolerance)
            assert np.abs(x - rest).max() < 2.0
            done += burst + 40


def mistreat_quasistatic(material: MaterialName, quality: Quality, frames: int, burst: int) -> None:
    """One pose after the other, each warm-started from the last."""
    tolerance = {"preview": 1e-2, "fine": 1e-3, "converged": 1e-9}[quality]
    done = seed = 0
    while done < frames:
        seed += 1
        for rest, body, held in scenes(material):
            layer = Quasistatic(body, held, quality=quality)
            for reference in violent(rest, burst, seed):
                x = layer.solve(reference)
                check(x, reference, held, layer.last_solve, tolerance)
                assert np.abs(x - reference).max() < 10 * (np.ptp(reference, axis=0).max() + np.ptp(rest, axis=0).max())
            np.testing.assert_allclose(layer.solve(rest), rest, atol=1e-9)
            done += burst + 2


MISTREAT = {"implicit-euler": mistreat_implicit_euler, "quasistatic": mistreat_quasistatic}


@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("method", MISTREAT)
def test_a_little_violence(method: str, material: MaterialName, quality: Quality) -> None:
    MISTREAT[method](material, quality, frames=10, burst=12)


@pytest.mark.parametrize("modulus", [2e4, 1e7])
def test_a_little_violence_on_a_body_with_a_coarse_system(modulus: float) -> None:
    rest, tets = bar(12, 7, 6)
    held = rest[:, 0] < 0.1
    solver = ImplicitEuler(ElasticBody(rest, tets, modulus), held, DT, quality="preview")
    motion = violent(rest, 12, 3)
    solver.reset(next(motion))
    for reference in motion:
        check(solver.step(reference), reference, held, solver.last_step, 5e-2)
    for _ in range(60):
        x = solver.step(rest)
        check(x, rest, held, solver.last_step, 5e-2)
    assert np.abs(x - rest).max() < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("quality", QUALITIES)
@pytest.mark.parametrize("material", MATERIALS)
@pytest.mark.parametrize("method", MISTREAT)
def test_ten_thousand_frames_of_violence(method: str, material: MaterialName, quality: Quality) -> None:
    MISTREAT[method](material, quality, frames=10_000, burst=60)
