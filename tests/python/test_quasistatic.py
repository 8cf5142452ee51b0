# SPDX-License-Identifier: GPL-3.0-or-later
"""Static equilibria against plain NumPy, against backward Euler that has come to rest, and against beam theory."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from bad_positions import bad_positions
from elastic_scenes import DT, Array, bar, random_rotation
from numpy.typing import NDArray
from plain_elastic import PlainBody

from followthrough.elastic import ElasticBody, ImplicitEuler, MaterialName
from followthrough.quasistatic import OverQuasistatic, Quasistatic
from followthrough.springs import Springs


def ends(rest: Array) -> NDArray[np.bool_]:
    """Both ends of a bar."""
    return np.asarray((rest[:, 0] < 1e-6) | (rest[:, 0] > rest[:, 0].max() - 1e-6))


def twisted(rest: Array, angle: float) -> Array:
    """Ever more towards the bar's far end."""
    middle = rest.mean(axis=0)
    turn = angle * rest[:, 0] / rest[:, 0].max()
    y, z = (rest - middle)[:, 1], (rest - middle)[:, 2]
    turned = np.stack([y * np.cos(turn) - z * np.sin(turn), y * np.sin(turn) + z * np.cos(turn)], axis=1)
    return np.column_stack([rest[:, 0], middle[1:] + turned])


def bent(rest: Array, angle: float) -> Array:
    """As linear blend skinning bends an elbow."""
    length, middle = rest[:, 0].max(), rest.mean(axis=0)
    weight = np.clip((rest[:, 0] / length - 0.35) / 0.3, 0, 1)[:, None]
    turn = np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
    posed: Array = (1 - weight) * rest + weight * ((rest - middle) @ turn.T + middle)
    return posed


def mistreated(rest: Array) -> dict[str, Array]:
    """Poses that squash the bar, tear at it and turn it inside out."""
    random = np.random.default_rng(7)
    middle = rest.mean(axis=0)
    flipped = rest.copy()
    flipped[ends(rest)] = (flipped[ends(rest)] - middle) * [1, -1, -1] + middle
    return {
        "wrung": twisted(rest, 2 * math.pi),
        "squashed": rest * [0.2, 1, 1],
        "flat": rest * [0, 1, 1],
        "past flat": rest * [-0.5, 1, 1],
        "mirrored": rest * [-1, 1, 1],
        "ends flipped": flipped,
        "inside out": 2 * middle - rest,
        "a point": np.tile(middle, (len(rest), 1)),
        "crumpled": rest + 0.3 * random.normal(size=rest.shape),
        "shredded": rest + random.normal(size=rest.shape),
        "far away": rest + 1e4,
        "huge": 100 * rest,
    }


def relative_residual(
    plain: PlainBody, x: Array, reference: Array, held: NDArray[np.bool_], weight: Array, pins: Array
) -> float:
    """What is left of the forces on free vertices, against what holds the body: tets without a free corner aside."""
    used = ~held[plain.tets].all(axis=1)
    pull = pins[:, None] * (x - reference)
    forces = plain.forces(x, used)
    left = (forces + pull - weight)[~held]
    holding = np.concatenate([forces[held], pull[~held], weight[~held]])
    return float(np.linalg.norm(left) / np.linalg.norm(holding))


@pytest.mark.parametrize("pose", ["twisted", "bent", "squeezed"])
@pytest.mark.parametrize("loads", ["none", "gravity", "pins", "both"])
def test_the_plain_forces_cancel(pose: str, loads: str) -> None:
    rest, tets = bar(6, 2, 2)
    modulus, density = np.geomspace(2e4, 2e5, len(rest)), np.linspace(500, 1500, len(rest))
    body, plain = ElasticBody(rest, tets, modulus, density=density), PlainBody(rest, tets, modulus, density)
    held = ends(rest)
    reference = {"twisted": twisted(rest, 1.5), "bent": bent(rest, 1.2), "squeezed": rest * [0.7, 1.1, 1]}[pose]
    gravity = np.array([0.5, 0.0, -9.81]) * (loads in ("gravity", "both"))
    pins = np.linspace(0, 300, len(rest)) * (loads in ("pins", "both"))
    layer = Quasistatic(body, held, gravity=gravity, pin_stiffness=pins)
    x = layer.solve(reference)
    assert layer.last_solve.converged
    np.testing.assert_array_equal(x[held], reference[held])
    weight = plain.mass_product(np.broadcast_to(gravity, rest.shape))
    assert relative_residual(plain, x, reference, held, weight, pins) < 1e-8
    assert relative_residual(plain, reference, reference, held, weight, pins) > 0.05
    assert body.energy(x) < body.energy(reference) or loads == "gravity"


@pytest.mark.parametrize("loads", [{}, {"gravity": [0, 0, -9.81]}, {"gravity": [0, 0, -9.81], "pin_stiffness": 50.0}])
def test_backward_euler_comes_to_rest_there(loads: dict[str, object]) -> None:
    rest, tets = bar(5, 2, 1)
    body = ElasticBody(rest, tets, np.geomspace(5e4, 2e5, len(rest)))
    held = ends(rest)
    reference = bent(rest, 1.0)
    layer = Quasistatic(body, held, **loads)  # type: ignore[arg-type]
    x = layer.solve(reference)
    solver = ImplicitEuler(body, held, 5.0, **loads)  # type: ignore[arg-type]
    solver.reset(rest)
    for share in np.linspace(0.1, 1, 10):
        solver.step(bent(rest, share))
    for _ in range(25):
        settled = solver.step(reference)
    np.testing.assert_allclose(x, settled, atol=1e-7)
    assert np.abs(x - reference).max() > 0.01


def test_a_hanging_bar_stretches_as_theory_says() -> None:
    rest, tets = bar(10, 2, 2, 0.1)
    modulus, density, gravity = 1e6, 1000.0, 0.1
    body = ElasticBody(rest, tets, modulus, density=density, poisson_ratio=0.0)
    hung = Quasistatic(body, rest[:, 0] < 0.05, gravity=[gravity, 0, 0]).solve(rest)
    x = np.linspace(0, 1, 11)
    sag = (hung - rest)[:, 0].reshape(11, -1)
    expected = density * gravity / modulus * (x - x**2 / 2)
    np.testing.assert_allclose(sag.mean(axis=1), expected, rtol=0.015, atol=1e-9)


def test_a_cantilever_sags_as_beam_theory_says() -> None:
    length, height, modulus, gravity = 2.0, 0.25, 1e7, 0.5
    rest, tets = bar(64, 8, 4, length / 64)
    body = ElasticBody(rest, tets, modulus, poisson_ratio=0.0, compression_resistance=0.0)
    hung = Quasistatic(body, rest[:, 0] < 1e-6, gravity=[0, -gravity, 0], tolerance=1e-5).solve(rest)
    sag = (rest[:, 1] - hung[:, 1])[rest[:, 0] > length - 1e-6].mean()
    theory = 1000.0 * gravity * length**4 * 12 / (8 * modulus * height**2)
    assert sag == pytest.approx(theory, rel=0.06)  # linear tets bend a little too stiffly


def test_rest_is_rest() -> None:
    rest, tets = bar(5, 2, 2)
    layer = Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest))
    for reference in (rest, rest @ random_rotation(np.random.default_rng(0)).T + [3.0, 2.0, 1.0]):
        layer.forget()
        np.testing.assert_allclose(layer.solve(reference), reference, rtol=0, atol=1e-12)
        assert layer.last_solve.converged
        assert layer.last_solve.iterations == 0


@pytest.mark.parametrize("material", ["invertible-stvk", "corotational"])
def test_a_rigidly_moved_reference_moves_the_answer_rigidly(material: MaterialName) -> None:
    rest, tets = bar(5, 2, 2)
    layer = Quasistatic(ElasticBody(rest, tets, 5e4, material=material), ends(rest))
    random = np.random.default_rng(1)
    still = layer.solve(bent(rest, 1.0))
    for _ in range(3):
        turn, shift = random_rotation(random), random.normal(size=3)
        moved = layer.solve(bent(rest, 1.0) @ turn.T + shift)
        assert layer.last_solve.converged
        np.testing.assert_allclose(moved, still @ turn.T + shift, atol=1e-8)


def test_along_an_animation_the_answers_are_the_same_and_sooner_there() -> None:
    rest, tets = bar(8, 3, 3)
    layer = Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest))
    frames = [twisted(bent(rest, 0.05 * frame), 0.04 * frame) for frame in range(16)]
    warm, work = [], 0
    for frame in frames:
        warm.append(layer.solve(frame))
        work += layer.last_solve.linear_iterations
    for known, frame in reversed(list(zip(warm, frames, strict=True))):
        np.testing.assert_allclose(layer.solve(frame), known, atol=1e-7)
    cold = 0
    for known, frame in zip(warm, frames, strict=True):
        layer.forget()
        np.testing.assert_allclose(layer.solve(frame), known, atol=1e-7)
        cold += layer.last_solve.linear_iterations
    assert work < 0.8 * cold


@pytest.mark.parametrize("quality", ["preview", "fine"])
def test_cheaper_qualities_are_cheaper_and_near(quality: str) -> None:
    rest, tets = bar(8, 3, 3)
    body = ElasticBody(rest, tets, 5e4)
    exact, cheap = Quasistatic(body, ends(rest)), Quasistatic(body, ends(rest), quality=quality)  # type: ignore[arg-type]
    work = {exact: 0, cheap: 0}
    for frame in range(10):
        reference = bent(rest, 0.1 * frame)
        results = []
        for layer in work:
            results.append(layer.solve(reference))
            work[layer] += layer.last_solve.linear_iterations
        assert np.abs(results[1] - results[0]).max() < (0.02 if quality == "preview" else 0.001)
    assert work[cheap] < 0.8 * work[exact]


@pytest.mark.parametrize("pose", list(mistreated(bar(1, 1, 1)[0])))
@pytest.mark.parametrize("material", ["invertible-stvk", "corotational"])
def test_mistreated_poses_stay_finite_and_are_reported(pose: str, material: MaterialName) -> None:
    rest, tets = bar(5, 2, 2)
    modulus = np.full(len(rest), 5e4)
    body, held = ElasticBody(rest, tets, modulus, material=material), ends(rest)
    reference = mistreated(rest)[pose]
    nothing = np.zeros_like(rest)
    for quality in ("preview", "fine", "converged"):
        layer = Quasistatic(body, held, quality=quality)  # type: ignore[arg-type]
        x = layer.solve(reference)
        report = layer.last_solve
        assert np.isfinite(x).all()
        np.testing.assert_array_equal(x[held], reference[held])
        size = np.ptp(reference, axis=0).max() + np.ptp(rest, axis=0).max()
        assert np.abs(x - reference).max() < 3 * size
        assert report.converged == (report.residual <= {"preview": 1e-2, "fine": 1e-3, "converged": 1e-9}[quality])
    assert report.converged or material == "corotational"
    if report.converged and material == "invertible-stvk" and pose != "far away":  # there, rounding is larger
        plain = PlainBody(rest, tets, modulus, np.full(len(rest), 1000.0))
        assert relative_residual(plain, x, reference, held, nothing, np.zeros(len(rest))) < 1e-8
    x = layer.solve(rest)  # and it recovers
    np.testing.assert_allclose(x, rest, atol=1e-9)


def test_a_part_that_nothing_holds_rests_unstrained_and_cannot_bear_gravity() -> None:
    rest, tets = bar(3, 1, 1)
    both = np.concatenate([rest, rest + np.array([0.0, 1.0, 0.0])])
    body = ElasticBody(both, np.concatenate([tets, tets + len(rest)]), 5e4)
    held = np.concatenate([ends(rest), np.zeros(len(rest), dtype=bool)])
    layer = Quasistatic(body, held)
    reference = bent(both, 0.8)
    x = layer.solve(reference)
    assert layer.last_solve.converged
    loose = x[len(rest) :]
    np.testing.assert_allclose(
        np.linalg.norm(loose[:, None] - loose, axis=2), np.linalg.norm(rest[:, None] - rest, axis=2), atol=1e-4
    )
    assert np.abs(loose.mean(axis=0) - reference[len(rest) :].mean(axis=0)).max() < 0.02
    layer.solve(bent(both, 0.1))
    np.testing.assert_allclose(layer.solve(reference), x, atol=1e-4)  # wherever it came from
    with pytest.raises(ValueError, match="constrained: found vertex 16 in a part of the body that nothing holds"):
        Quasistatic(body, held, gravity=[0, 0, -1])
    pins = np.zeros(len(both))
    pins[20] = 1e4
    assert np.isfinite(Quasistatic(body, held, gravity=[0, 0, -1], pin_stiffness=pins).solve(both)).all()


def test_results_do_not_depend_on_threads_or_instruction_sets() -> None:
    script = (
        "import hashlib, numpy as np\n"
        "from elastic_scenes import bar\n"
        "from followthrough.elastic import ElasticBody\n"
        "from followthrough.quasistatic import Quasistatic\n"
        "rest, tets = bar(24, 9, 9)\n"
        "layer = Quasistatic(ElasticBody(rest, tets, 5e4), rest[:, 0] < 1, quality='preview', gravity=[0, 0, -3.0])\n"
        "results = [layer.solve(rest * [stretch, 1, 1]) for stretch in (0.9, 1.1)]\n"
        "print(hashlib.sha256(b''.join(r.tobytes() for r in results)).hexdigest())\n"
    )
    hashes = set()
    for threads, instructions in (("1", ""), ("2", ""), ("4", "baseline")):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "FOLLOWTHROUGH_INSTRUCTION_SET": instructions}
        environment["PYTHONPATH"] = os.pathsep.join(sys.path)
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        hashes.add(done.stdout)
    assert len(hashes) == 1


def test_bad_input_is_refused_by_name() -> None:
    rest, tets = bar(2, 1, 1)
    body, held = ElasticBody(rest, tets, 1e5), ends(rest)
    for arguments, message in (
        ({"constrained": np.ones(len(rest), dtype=bool)}, "constrained: found no free vertex"),
        ({"constrained": held[:-1]}, "constrained: found shape"),
        ({"tolerance": 0.0}, "tolerance: found 0"),
        ({"tolerance": math.nan}, "tolerance: found nan"),
        ({"gravity": [0, 0, math.inf]}, "gravity"),
        ({"gravity": [0, 0]}, "gravity: found shape"),
        ({"pin_stiffness": np.full(len(rest), -1.0)}, "pin_stiffness: found -1"),
        ({"pin_stiffness": np.ones(3)}, "pin_stiffness: found shape"),
        ({"quality": "best"}, "quality: found 'best'"),
    ):
        with pytest.raises(ValueError, match=message):
            Quasistatic(body, **({"constrained": held} | arguments))  # type: ignore[arg-type]
    layer = Quasistatic(body, held)
    known = layer.solve(rest * [1.1, 1, 1])
    for wrong in bad_positions(rest):
        with pytest.raises(ValueError, match="reference"):
            layer.solve(wrong)
    np.testing.assert_allclose(layer.solve(rest * [1.1, 1, 1]), known, atol=1e-10)
    with pytest.raises(ValueError, match="solver"):
        OverQuasistatic(layer, Springs(np.ones(3), np.ones(3), DT))


def moving(rest: Array) -> list[Array]:
    """Frames of a bar that bends and shakes."""
    return [bent(rest, 0.2 * math.sin(frame)) + np.array([0, 0.1 * math.cos(2 * frame), 0]) for frame in range(9)]


def springs_over(rest: Array, tets: NDArray[np.int32]) -> OverQuasistatic:
    count = len(rest)
    springs = Springs(np.full(count, 400.0), np.full(count, 5.0), DT, ends(rest))
    return OverQuasistatic(Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest)), springs)


def test_springs_over_the_layer_are_springs_on_equilibria() -> None:
    rest, tets = bar(5, 2, 1)
    frames = moving(rest)
    solver = springs_over(rest, tets)
    springs = Springs(np.full(len(rest), 400.0), np.full(len(rest), 5.0), DT, ends(rest))
    layer = Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest))
    rests = [layer.solve(frame) for frame in frames]
    alone = OverQuasistatic(Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest)))
    solver.reset(frames[0])
    springs.reset(rests[0])
    alone.reset(frames[0])
    for now, ahead, found, found_ahead in zip(
        frames[1:], [*frames[2:], None], rests[1:], [*rests[2:], None], strict=True
    ):
        np.testing.assert_array_equal(solver.step(now, ahead), springs.step(found, found_ahead))
        np.testing.assert_array_equal(alone.step(now, ahead), found)
        assert solver.converged and alone.converged
    assert np.abs(springs.state().arrays[0] - rests[-1]).max() > 1e-3


def test_over_the_layer_a_state_resumes_bit_for_bit_and_history_too() -> None:
    rest, tets = bar(5, 2, 1)
    frames = moving(rest)
    solver, other = springs_over(rest, tets), springs_over(rest, tets)
    with pytest.raises(ValueError, match="before the first reset"):
        solver.step(rest)
    other.restore(solver.state())
    solver.reset(frames[0])
    results = [frames[0]]
    for frame in range(1, 8):
        if frame == 4:
            state = solver.state()
        results.append(solver.step(frames[frame], frames[frame + 1]))
    other.restore(state)
    for frame in range(4, 8):
        np.testing.assert_array_equal(other.step(frames[frame], frames[frame + 1]), results[frame])
    with pytest.raises(ValueError, match="state"):
        other.restore(OverQuasistatic(solver.layer).state())
    equilibria = OverQuasistatic(Quasistatic(ElasticBody(rest, tets, 5e4), ends(rest)))
    equilibria.resume(np.array(frames[:3]), np.array(frames[:3]))
    assert equilibria.state().frames == 2
    np.testing.assert_allclose(equilibria.step(frames[3]), solver.layer.solve(frames[3]), atol=1e-8)
    still = springs_over(rest, tets)
    still.resume(np.repeat(rest[None], 4, axis=0), np.repeat(rest[None], 4, axis=0))
    np.testing.assert_allclose(still.step(rest), rest, atol=1e-12)
