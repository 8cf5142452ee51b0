# SPDX-License-Identifier: GPL-3.0-or-later
"""The elastic ground truth against plain NumPy and against what mechanics says."""

import itertools
import math

import numpy as np
import pytest
from elastic_scenes import DT, Array, bar, random_rotation, swung
from plain_elastic import PlainBody

from followthrough.elastic import CentralDifferences, ElasticBody, ImplicitEuler, MaterialName


@pytest.mark.parametrize(("low", "high"), [(5e4, 5e4), (5e6, 5e6), (1e4, 1e6)])
def test_every_step_solves_the_equation_of_backward_euler(low: float, high: float) -> None:
    rest, tets = bar(5, 2, 2)
    modulus = np.geomspace(low, high, len(rest))
    density = np.linspace(500, 1500, len(rest))
    body = ElasticBody(rest, tets, modulus, density=density)
    plain = PlainBody(rest, tets, modulus, density)
    constrained = rest[:, 0] < 0.1
    solver = ImplicitEuler(body, constrained, DT)
    motion = list(swung(rest, 14))
    solver.reset(motion[0])
    history = [motion[0], motion[0]]
    for reference in motion[1:]:
        history.append(solver.step(reference))
        assert solver.last_step.converged
        np.testing.assert_array_equal(history[-1][constrained], reference[constrained])
        inertia = plain.mass_product(history[-1] - 2 * history[-2] + history[-3])[~constrained]
        elastic = DT**2 * plain.forces(history[-1])[~constrained]
        assert np.linalg.norm(inertia + elastic) < 1e-8 * np.linalg.norm(inertia)
    assert np.abs(history[-1] - motion[-1]).max() > 1e-3


def test_a_dense_newton_with_the_plain_forces_agrees() -> None:
    rest, tets = bar(3, 1, 1)
    modulus = np.full(len(rest), 5e4)
    body = ElasticBody(rest, tets, modulus)
    plain = PlainBody(rest, tets, modulus, np.full(len(rest), 1000.0))
    constrained = rest[:, 0] < 0.1
    free = ~np.repeat(constrained, 3)
    solver = ImplicitEuler(body, constrained, DT)
    motion = [rest + 0.4 * (reference - rest) for reference in swung(rest, 6)]
    solver.reset(motion[0])
    before = now = motion[0]
    for last, reference in itertools.pairwise(motion):
        x = np.where(constrained[:, None], reference, 0.5 * (2 * now - before + now + reference - last))

        def size(x: Array, before: Array = before, now: Array = now) -> float:
            residual = plain.mass_product(x - 2 * now + before) + DT**2 * plain.forces(x)
            return float(np.linalg.norm(residual.ravel()[free]))

        for _ in range(60):
            residual = (plain.mass_product(x - 2 * now + before) + DT**2 * plain.forces(x)).ravel()
            tangent = np.zeros((x.size, x.size))
            for k in np.flatnonzero(free):
                change = np.zeros(x.size)
                change[k] = 1e-6
                change = change.reshape(x.shape)
                slope = (plain.forces(x + change) - plain.forces(x - change)) / 2e-6
                tangent[:, k] = (plain.mass_product(change) / 1e-6 + DT**2 * slope).ravel()
            move = np.zeros(x.size)
            move[free] = np.linalg.solve(tangent[np.ix_(free, free)], -residual[free])
            share = 1.0
            while size(x + share * move.reshape(x.shape)) > size(x) and share > 1e-3:
                share /= 2
            x = x + share * move.reshape(x.shape)
            if np.abs(move).max() < 1e-13:
                break
        else:
            pytest.fail("the dense Newton has not converged")
        before, now = now, solver.step(reference)
        np.testing.assert_allclose(now, x, atol=1e-10)


def test_forces_and_mass_are_the_plain_ones_even_of_inverted_tets() -> None:
    random = np.random.default_rng(1)
    rest, tets = bar(3, 2, 2)
    modulus, density = random.uniform(1e4, 1e6, len(rest)), random.uniform(500, 2000, len(rest))
    body, plain = ElasticBody(rest, tets, modulus, density=density), PlainBody(rest, tets, modulus, density)
    for size in (0.01, 0.1, 0.5):
        x = rest + size * random.normal(size=rest.shape)
        expected = plain.forces(x)
        np.testing.assert_allclose(body.internal_forces(x), expected, atol=1e-12 * np.abs(expected).max())
        np.testing.assert_allclose(body.mass_product(x), plain.mass_product(x), rtol=1e-12)
    assert (plain.stretches(x)[1] < 0).any()
    np.testing.assert_allclose(body.lumped_mass, plain.mass_product(np.ones_like(rest))[:, 0], rtol=1e-12)


@pytest.mark.parametrize("material", ["invertible-stvk", "corotational"])
def test_forces_are_the_slope_of_the_energy_and_stiffness_is_theirs(material: MaterialName) -> None:
    random = np.random.default_rng(2)
    rest, tets = bar(2, 2, 1)
    body = ElasticBody(rest, tets, np.geomspace(1e4, 1e5, len(rest)), material=material)
    x = rest + 0.02 * random.normal(size=rest.shape)
    h = 1e-6
    for _ in range(5):
        change = random.normal(size=rest.shape)
        slope = (body.energy(x + h * change) - body.energy(x - h * change)) / (2 * h)
        forces = body.internal_forces(x)
        assert np.sum(forces * change) == pytest.approx(slope, rel=1e-5, abs=1e-6 * np.abs(forces).max())
        difference = (body.internal_forces(x + h * change) - body.internal_forces(x - h * change)) / (2 * h)
        product = body.stiffness_product(x, change)
        np.testing.assert_allclose(product, difference, atol=1e-6 * np.abs(product).max())
        assert np.sum(change * body.stiffness_product(x, change, semidefinite=True)) >= 0


def test_a_tet_that_is_driven_through_the_clamp_and_turned_inside_out_comes_back() -> None:
    # The apex moves straight through the base: one stretch t, and one equation that can be written down.
    rest = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    modulus, density, volume = 2e4, 1000.0, 1 / 6
    mu, lam = modulus / 2.9, modulus * 0.45 / (1.45 * 0.1)

    def force(t: float) -> float:  # of the apex, along its way
        s = max(t, 0.1)
        return volume * ((2 * mu + lam) * s * (s * s - 1) / 2 - 1e5 * modulus * max(1 - s, 0) ** 2 / 576)

    body = ElasticBody(rest, np.array([[0, 1, 2, 3]]), modulus, density=density)
    for t in (1.2, 0.5, 0.1 + 1e-6, 0.1 - 1e-6, 0.02, -0.3, -0.9):
        x = rest.copy()
        x[3, 2] = t
        expected = np.array([0, 0, force(t)])
        np.testing.assert_allclose(body.internal_forces(x)[3], expected, atol=1e-9 * abs(force(0)))
        up, down = x.copy(), x.copy()
        up[3, 2], down[3, 2] = t + 1e-7, t - 1e-7
        assert (body.energy(up) - body.energy(down)) / 2e-7 == pytest.approx(force(t), rel=1e-5)

    solver = ImplicitEuler(body, np.array([True, True, True, False]), DT)
    start = rest.copy()
    start[3, 2] = -0.6
    solver.reset(start)
    way = [-0.6, -0.6]
    for _ in range(120):
        way.append(float(solver.step(rest)[3, 2]))
        inertia = density * volume / 10 * (way[-1] - 2 * way[-2] + way[-3])  # the base does not move
        assert inertia + DT**2 * force(way[-1]) == pytest.approx(0, abs=1e-8 * abs(inertia) + 1e-9)
    assert min(way) == -0.6
    assert any(0 < t < 0.1 for t in way) or any(a < 0.1 < b for a, b in itertools.pairwise(way))
    assert way[-1] == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("material", ["invertible-stvk", "corotational"])
def test_rigid_motions_give_no_force_and_forces_no_momentum(material: MaterialName) -> None:
    random = np.random.default_rng(3)
    rest, tets = bar(3, 2, 2)
    body = ElasticBody(rest, tets, 1e5, material=material)
    for _ in range(10):
        turn, shift = random_rotation(random), random.normal(size=3)
        assert np.abs(body.internal_forces(rest @ turn.T + shift)).max() < 1e-9
        x = rest + 0.1 * random.normal(size=rest.shape)
        forces = body.internal_forces(x)
        scale = np.abs(forces).sum()
        assert np.abs(forces.sum(axis=0)).max() < 1e-13 * scale
        assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-13 * scale
        turned = body.internal_forces(x @ turn.T + shift)
        np.testing.assert_allclose(turned, forces @ turn.T, atol=1e-10 * scale)


def test_rest_is_rest_and_a_free_body_flies_straight() -> None:
    random = np.random.default_rng(4)
    rest, tets = bar(3, 2, 1)
    body = ElasticBody(rest, tets, 5e4)
    solver = ImplicitEuler(body, np.zeros(len(rest), dtype=bool), DT)
    solver.reset(rest)
    for _ in range(3):
        np.testing.assert_allclose(solver.step(rest), rest, atol=1e-12)
        assert solver.last_step.converged
    state = solver.state()
    state.arrays[1][:] = rest - 0.02 * random.normal(size=rest.shape) - [0.03, 0.01, -0.02]
    solver.restore(state)
    momentum = body.mass_product(rest - state.arrays[1]).sum(axis=0)
    now = rest
    for _ in range(20):
        before, now = now, solver.step(rest)
        np.testing.assert_allclose(body.mass_product(now - before).sum(axis=0), momentum, atol=1e-10)
        assert solver.last_step.converged


def test_a_hanging_bar_stretches_as_theory_says() -> None:
    rest, tets = bar(10, 2, 2, 0.1)
    modulus, density, gravity = 1e6, 1000.0, 0.1
    body = ElasticBody(rest, tets, modulus, density=density, poisson_ratio=0.0)
    solver = ImplicitEuler(body, rest[:, 0] < 0.05, 10.0, gravity=[gravity, 0, 0])  # steps so long that nothing swings
    solver.reset(rest)
    for _ in range(6):
        hung = solver.step(rest)
    x = np.linspace(0, 1, 11)
    sag = (hung - rest)[:, 0].reshape(11, -1)
    expected = density * gravity / modulus * (x - x**2 / 2)
    np.testing.assert_allclose(sag.mean(axis=1), expected, rtol=0.015, atol=1e-9)
    np.testing.assert_allclose(sag, np.broadcast_to(expected[:, None], sag.shape), rtol=0.05, atol=1e-9)


def test_a_cantilever_sags_as_beam_theory_says() -> None:
    length, height, modulus, gravity = 2.0, 0.25, 1e7, 0.5
    rest, tets = bar(64, 8, 4, length / 64)
    body = ElasticBody(rest, tets, modulus, poisson_ratio=0.0, compression_resistance=0.0)
    solver = ImplicitEuler(body, rest[:, 0] < 1e-6, 10.0, gravity=[0, -gravity, 0], tolerance=1e-6)
    solver.reset(rest)
    for _ in range(4):
        hung = solver.step(rest)
    sag = (rest[:, 1] - hung[:, 1])[rest[:, 0] > length - 1e-6].mean()
    theory = 1000.0 * gravity * length**4 * 12 / (8 * modulus * height**2)
    assert sag == pytest.approx(theory, rel=0.06)  # linear tets bend a little too stiffly


@pytest.mark.parametrize("stiffness_damping", [0.0, 0.01])
def test_a_free_vibration_has_the_period_and_decay_of_theory(stiffness_damping: float) -> None:
    length, modulus, density = 1.0, 1e5, 1000.0
    rest, tets = bar(10, 1, 1, length / 10)
    body = ElasticBody(rest, tets, modulus, density=density, poisson_ratio=0.0, compression_resistance=0.0)
    constrained = rest[:, 0] < 0.05
    free = np.flatnonzero(~np.repeat(constrained, 3))
    mass, stiffness = np.zeros((len(free), len(free))), np.zeros((len(free), len(free)))
    for column, k in enumerate(free):
        unit = np.zeros(rest.size)
        unit[k] = 1
        mass[:, column] = body.mass_product(unit.reshape(rest.shape)).ravel()[free]
        stiffness[:, column] = body.stiffness_product(rest, unit.reshape(rest.shape)).ravel()[free]
    squares, modes = np.linalg.eig(np.linalg.solve(mass, stiffness))
    along = np.abs(modes.reshape(-1, 3, len(free))[:, 0]).sum(axis=0) / np.abs(modes).sum(axis=0)
    lengthwise = np.flatnonzero(along > 0.9)
    chosen = lengthwise[np.argmin(squares[lengthwise].real)]
    omega = math.sqrt(squares[chosen].real)
    assert omega == pytest.approx(math.pi / (2 * length) * math.sqrt(modulus / density), rel=0.01)

    mode = np.zeros(rest.size)
    mode[free] = modes[:, chosen].real
    mode = mode.reshape(rest.shape) / np.abs(mode).max()
    solver = ImplicitEuler(body, constrained, DT, stiffness_damping=stiffness_damping)
    solver.reset(rest)
    state = solver.state()
    amplitude = 1e-6  # small enough to be linear
    state.arrays[0][:] = state.arrays[1][:] = rest + amplitude * mode
    solver.restore(state)
    damping = stiffness_damping * omega**2 * DT
    before = now = 1.0
    crossings = []
    for frame in range(1, 60):
        before, now = now, ((2 + damping) * now - before) / (1 + damping + (omega * DT) ** 2)
        x = solver.step(rest)
        assert np.sum((x - rest) * mode) / np.sum(mode * mode) == pytest.approx(amplitude * now, abs=2e-4 * amplitude)
        if now * before < 0:
            crossings.append(frame - now / (now - before))
    if not stiffness_damping:
        assert np.diff(crossings).mean() == pytest.approx(math.pi / math.atan(omega * DT), rel=0.02)


def test_gravity_damping_and_soft_pins_act_as_their_equations_say() -> None:
    rest, tets = bar(2, 1, 1)
    body = ElasticBody(rest, tets, 1e5)
    loose = np.zeros(len(rest), dtype=bool)
    alpha, pull = 3.0, 40.0
    for options, target in (
        ({"gravity": [0, 0, -9.81]}, 0.0),
        ({"mass_damping": alpha, "gravity": [0, 0, -9.81]}, 0.0),
        ({"pin_stiffness": pull * body.lumped_mass}, 0.3),
    ):
        solver = ImplicitEuler(body, loose, DT, **options)
        solver.reset(rest)
        damping = options.get("mass_damping", 0.0) * DT
        gravity = options.get("gravity", [0, 0, 0])[2] * DT**2
        spring = pull * DT**2 if "pin_stiffness" in options else 0.0
        before = now = 0.0
        for _ in range(10):
            goal = (2 + damping) * now - before + gravity + spring * target
            before, now = now, goal / (1 + damping + spring)
            x = solver.step(rest + np.array([0, 0, target]))
            np.testing.assert_allclose(x - rest, np.broadcast_to([0, 0, now], rest.shape), atol=1e-10)


def test_a_step_that_cannot_converge_says_so() -> None:
    rest, tets = bar(4, 2, 2)
    body = ElasticBody(rest, tets, 5e4)
    solver = ImplicitEuler(body, rest[:, 0] < 0.1, DT, quality="preview", tolerance=1e-12)
    solver.reset(rest)
    solver.step(rest + np.array([0.3, 0.1, 0.0]))
    assert not solver.last_step.converged
    assert solver.last_step.iterations == 6


def test_inverted_rest_tets_warn_and_still_rest() -> None:
    rest, tets = bar(2, 1, 1)
    tets = tets.copy()
    tets[3, [0, 1]] = tets[3, [1, 0]]
    outside_in = rest * [-1, 1, 1]
    count = int((np.linalg.det(outside_in[tets[:, 1:]] - outside_in[tets[:, :1]]) < 0).sum())
    assert 0 < count < len(tets)
    with pytest.warns(UserWarning, match=rf"{count} of {len(tets)} tets are inverted"):
        body = ElasticBody(outside_in, tets, 1e5)
    assert body.inverted_rest_tets == count
    assert np.abs(body.internal_forces(outside_in)).max() < 1e-9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"youngs_modulus": -1.0}, "youngs_modulus: found -1"),
        ({"youngs_modulus": math.nan}, "youngs_modulus: found nan"),
        ({"density": 0.0}, "density: found 0"),
        ({"poisson_ratio": 0.5}, "poisson_ratio"),
        ({"compression_resistance": -1.0}, "compression_resistance"),
        ({"youngs_modulus": np.ones(3)}, "youngs_modulus: found shape"),
        ({"tets": np.array([[0, 1, 2, 99]])}, "tets: row 0 holds index 99"),
        ({"tets": np.array([[0, 1, 2, 2**32]])}, "tets: found index"),
        ({"tets": np.array([[0, 1, 2, 2]])}, "tet 0 has no volume"),
        ({"material": "jelly"}, "material"),
    ],
)
def test_bad_bodies_are_refused(change: dict[str, object], message: str) -> None:
    rest, tets = bar(2, 1, 1)
    arguments: dict[str, object] = {"rest_positions": rest, "tets": tets, "youngs_modulus": 1e5}
    with pytest.raises(ValueError, match=message):
        ElasticBody(**(arguments | change))  # type: ignore[arg-type]


def test_bad_solvers_and_references_are_refused() -> None:
    rest, tets = bar(2, 1, 1)
    body = ElasticBody(rest, tets, 1e5)
    constrained = rest[:, 0] < 0.1
    with pytest.raises(ValueError, match="no free vertex"):
        ImplicitEuler(body, np.ones(len(rest), dtype=bool), DT)
    with pytest.raises(ValueError, match="constrained: found shape"):
        ImplicitEuler(body, constrained[:-1], DT)
    with pytest.raises(ValueError, match="dt"):
        ImplicitEuler(body, constrained, 0.0)
    with pytest.raises(ValueError, match="pin_stiffness"):
        ImplicitEuler(body, constrained, DT, pin_stiffness=np.full(len(rest), -1.0))
    solver = ImplicitEuler(body, constrained, DT)
    with pytest.raises(ValueError, match="before the first reset"):
        solver.step(rest)
    solver.reset(rest)
    with pytest.raises(ValueError, match="reference"):
        solver.step(np.full_like(rest, np.nan))
    assert solver.state().frames == 0


def test_central_differences_explode_at_one_step_a_frame_and_are_stable_at_a_hundred() -> None:
    rest, tets = bar(5, 2, 2)
    body = ElasticBody(rest, tets, 5e5)
    motion = [rest + 0.3 * (reference - rest) for reference in swung(rest, 30)]
    largest = {}
    for substeps in (1, 100, None):
        solver = CentralDifferences(body, rest[:, 0] < 0.1, DT, substeps=substeps)
        solver.reset(motion[0])
        for reference in motion[1:]:
            x = solver.step(reference)
            if not np.isfinite(x).all():
                break
        largest[substeps] = np.abs(x - reference).max()
        assert solver.last_substeps == substeps or (substeps is None and solver.last_substeps > 10)
    assert not largest[1] < 1e3
    assert largest[100] < 2 and largest[None] < 2


def test_central_differences_take_a_frame_in_more_substeps_than_its_start_asks_for() -> None:
    rest, tets = bar(5, 2, 2)
    body = ElasticBody(rest, tets, 5e4)
    references = [rest, rest + 1.5 * (np.arange(3) == 0), rest]  # jerked by several edges, and back
    paths = []
    for restoring in (False, True):
        solver = CentralDifferences(body, rest[:, 0] < 0.1, DT)
        solver.reset(rest)
        paths.append([])
        for reference in references:
            paths[-1].append(solver.step(reference))
            assert solver.last_substeps >= DT / solver.stable_step(paths[-1][-1])
            if restoring:  # what is remembered of the frame's end changes nothing
                solver.restore(solver.state())
    np.testing.assert_array_equal(*paths)
    assert np.abs(paths[0]).max() < 5
    # As many as the rest asks for, the same share below the limit, explode.
    enough = int(np.ceil(DT / (0.4 * solver.stable_step(rest))))
    exploding = CentralDifferences(body, rest[:, 0] < 0.1, DT, substeps=enough)
    exploding.reset(rest)
    for reference in references:
        last = exploding.step(reference)
    assert not np.abs(last).max() < 100


def test_central_differences_are_of_second_order_and_keep_the_energy() -> None:
    rest, tets = bar(3, 1, 1)
    body = ElasticBody(rest, tets, 1e5, compression_resistance=0.0)
    constrained = rest[:, 0] < 0.1
    start = rest + 0.05 * rest[:, :1] * [0.0, 1.0, 0.5]
    ends = []
    for substeps in (200, 400, 800):
        solver = CentralDifferences(body, constrained, DT, substeps=substeps)
        solver.reset(rest)
        solver.resume(np.array([start]), np.array([rest]))
        for _ in range(4):
            x = solver.step(rest)
        velocities = solver.state().arrays[1]
        ends.append(x)
        mass = body.lumped_mass[:, None] * ~constrained[:, None]
        energy = body.energy(x) + 0.5 * np.sum(mass * velocities**2)
        assert energy == pytest.approx(body.energy(start), rel=1e-3)
    assert np.abs(ends[1] - ends[2]).max() == pytest.approx(np.abs(ends[0] - ends[1]).max() / 4, rel=0.05)


def test_the_stable_step_is_where_a_mode_starts_to_grow() -> None:
    rest, tets = bar(2, 1, 1)
    body = ElasticBody(rest, tets, 1e5, compression_resistance=0.0)
    constrained = rest[:, 0] < 0.1
    stable = CentralDifferences(body, constrained, DT).stable_step(rest)
    free = np.flatnonzero(~np.repeat(constrained, 3))
    stiffness = np.array([body.stiffness_product(rest, unit.reshape(rest.shape)).ravel() for unit in np.eye(rest.size)])
    scaled = stiffness[np.ix_(free, free)] / np.repeat(body.lumped_mass, 3)[free]
    assert stable == pytest.approx(2 / math.sqrt(np.abs(np.linalg.eigvals(scaled)).max()), rel=0.05)


def test_central_differences_resume_and_refuse() -> None:
    rest, tets = bar(2, 1, 1)
    body = ElasticBody(rest, tets, 1e5)
    constrained = rest[:, 0] < 0.1
    solver = CentralDifferences(body, constrained, DT, mass_damping=2.0, gravity=[0, 0, -1])
    motion = list(swung(rest, 6))
    solver.reset(motion[0])
    solver.step(motion[1])
    state = solver.state()
    first = solver.step(motion[2])
    solver.step(motion[3])
    solver.restore(state)
    np.testing.assert_array_equal(solver.step(motion[2]), first)
    for substeps in (0, -3, 10**6):
        with pytest.raises(ValueError, match="substeps"):
            CentralDifferences(body, constrained, DT, substeps=substeps)
    with pytest.raises(ValueError, match="no free vertex"):
        CentralDifferences(body, np.ones(len(rest), dtype=bool), DT)
