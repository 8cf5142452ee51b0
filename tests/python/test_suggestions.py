# SPDX-License-Identifier: GPL-3.0-or-later
"""What is suggested makes parts of a character swing as such parts do, whatever their shape and the character's size are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from followthrough import suggestions
from followthrough.character import FloatArray, Paint, Rig, Surface
from followthrough.datasets.surfaces import ellipsoid, together, tube
from followthrough.flesh import paint_flesh, true_solver
from followthrough.settings import SimulationSettings, VolumeSettings
from followthrough.suggestions import suggest_paint
from followthrough.volume import build_volume

#: A fat body on a spine, and two long, thin ears that no bone holds beyond their roots: in metres, where it is 1.3 m tall.
BONES = [((0.0, 0.0, 0.1), (0.0, 0.0, 0.7)), ((0.0, 0.0, 0.7), (0.0, 0.0, 0.85))]
EAR_TIP = np.array([0.3, 0.0, 1.3])
BELLY = np.array([0.0, 0.3, 0.4])


def creature(scale: float = 1.0) -> Surface:
    parts = [
        ellipsoid((0.0, 0.0, 0.4), (0.3, 0.3, 0.38), rings=16, sides=24),
        ellipsoid((0.0, 0.0, 0.85), (0.14, 0.14, 0.14), rings=10, sides=16),
    ]
    for side in (1.0, -1.0):
        line = np.linspace((side * 0.06, 0.0, 0.92), (side * EAR_TIP[0], 0.0, EAR_TIP[2]), 12)
        parts.append(tube(line, np.linspace(0.055, 0.035, 12), side=(0.0, 1.0, 0.0), sides=10))
    whole = together(parts)
    points = np.asarray(whole.vertices)
    nearer = (points[:, 2] > 0.72).astype(np.float64)
    return Surface(
        rest_positions=scale * points,
        triangles=np.asarray(whole.triangles, dtype=np.int32),
        rig=Rig(
            bone_indices=np.tile(np.array([[0, 1]], dtype=np.int32), (len(points), 1)),
            bone_weights=np.column_stack([1.0 - nearer, nearer]),
            bone_segments=scale * np.array(BONES),
        ),
    )


@pytest.fixture(scope="module")
def surface() -> Surface:
    return creature()


@pytest.fixture(scope="module")
def paint(surface: Surface) -> Paint:
    return suggest_paint(surface)


def near(surface: Surface, place: FloatArray, radius: float) -> np.ndarray:
    return np.linalg.norm(surface.rest_positions - place, axis=1) < radius


def frequency(surface: Surface, paint: Paint, place: FloatArray, push: FloatArray) -> float:
    """Hertz at which the flesh at a place swings after a steady push has ended, in fine time steps of the true solver."""
    volume = build_volume(surface, paint, VolumeSettings())
    flesh = paint_flesh(volume, SimulationSettings())
    rest = volume.tet_mesh.vertices
    vertex = int(np.linalg.norm(rest - place, axis=1).argmin())
    pushed = true_solver(volume, dataclasses.replace(flesh, gravity=tuple(push)), 0.05, quality="fine")
    pushed.reset(rest)
    for _ in range(200):
        bent = pushed.step(rest)
    fps = 250.0
    solver = true_solver(volume, dataclasses.replace(flesh, gravity=(0.0, 0.0, 0.0)), 1.0 / fps, quality="fine")
    solver.resume(np.array([bent, bent]), np.array([rest, rest]))
    swing = np.array([(solver.step(rest)[vertex] - rest[vertex]) @ push for _ in range(250)])
    sign = np.signbit(swing)
    crossings = np.flatnonzero(sign[1:] != sign[:-1])
    assert len(crossings) >= 2, "it must swing"
    return fps / (2.0 * float(np.diff(crossings[:4]).mean()))


@pytest.mark.parametrize(
    ("place", "push"),
    [(BELLY, np.array([0.0, 0.0, -0.2])), (EAR_TIP, np.array([0.0, 0.2, 0.0]))],
    ids=["belly", "ear"],
)
def test_parts_swing_a_few_times_a_second(surface, paint, place, push):
    assert 2.5 < frequency(surface, paint, place, push) < 6.0


def test_thin_parts_are_stiffer_than_fat_ones(surface, paint):
    ears, belly = near(surface, EAR_TIP, 0.2), near(surface, BELLY, 0.12)
    assert paint.stiffness[ears].min() > paint.stiffness[belly].max() + 0.1


def test_what_is_near_bones_is_pinned_and_the_rest_is_free_to_move(surface, paint):
    assert (paint.pins[surface.bone_distances < 0.02] == 1.0).all()
    assert paint.pins[near(surface, BELLY, 0.05)].max() < 0.5
    assert paint.pins[near(surface, EAR_TIP, 0.1)].max() < 0.3


def test_an_ear_is_held_ever_less_towards_its_tip(surface, paint):
    ear = surface.rest_positions[:, 2] > 1.0
    height, pins = surface.rest_positions[ear, 2], paint.pins[ear]
    bands = [pins[(height >= low) & (height < low + 0.1)].mean() for low in (1.0, 1.1, 1.2)]
    assert bands[0] > bands[1] > bands[2] > 0.0


@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_a_scaled_copy_gets_the_same_paint(paint, scale):
    scaled = suggest_paint(creature(scale))
    for name in ("stiffness", "mass", "pins"):
        assert getattr(scaled, name) == pytest.approx(getattr(paint, name), abs=2e-3)


def test_neighbours_are_painted_alike(surface, paint):
    edges = np.concatenate([surface.triangles[:, [0, 1]], surface.triangles[:, [1, 2]]])
    # Edges of this coarse mesh are up to a tenth of a metre long.
    assert np.abs(np.diff(paint.stiffness[edges], axis=1)).max() < 0.45


def test_values_are_paint(paint):
    for name in ("stiffness", "mass", "pins"):
        values = getattr(paint, name)
        assert np.isfinite(values).all() and values.min() >= 0.0 and values.max() <= 1.0


def test_without_bones_nothing_is_pinned(surface):
    bare = dataclasses.replace(surface, rig=None)
    suggested = suggest_paint(bare)
    assert not suggested.pins.any() and (suggested.stiffness == 0.5).all()


def test_skin_that_lies_on_the_bones_is_pinned_and_left_at_that():
    whole = ellipsoid((0.0, 0.0, 0.5), (1e-4, 1e-4, 0.5), rings=8, sides=8)
    count = len(whole.vertices)
    surface = Surface(
        np.asarray(whole.vertices),
        np.asarray(whole.triangles, dtype=np.int32),
        rig=Rig(np.zeros((count, 1), dtype=np.int32), np.ones((count, 1)), np.array([[(0, 0, 0), (0, 0, 1.0)]])),
    )
    assert np.isfinite(suggest_paint(surface).stiffness).all()


def test_the_rule_of_the_sag_is_that_of_textbooks():
    """A beam's tip sags by 1.545 / ω² and a layer's top by 1.234 / ω²: the factor lies between, within an eighth of either in frequency."""
    assert 1.234 < suggestions.SAG_FACTOR < 1.545
    for exact in (1.234, 1.545):
        assert np.sqrt(suggestions.SAG_FACTOR / exact) == pytest.approx(1.0, abs=0.125)
