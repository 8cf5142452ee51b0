# SPDX-License-Identifier: GPL-3.0-or-later
"""Zero-restlength springs against what mechanics says of them."""

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from bad_positions import bad_positions
from numpy.typing import NDArray

from followthrough.springs import Springs

Motion = Callable[[float], NDArray[np.float64]]


def run(springs: Springs, frames: Iterable[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Positions of every frame, the first one included."""
    motion = list(frames)
    springs.reset(motion[0])
    result = [motion[0]]
    for frame in range(1, len(motion)):
        ahead = motion[frame + 1] if frame + 1 < len(motion) else None
        result.append(springs.step(motion[frame], ahead))
    return np.array(result)


def one_particle(stiffness: float, damping: float, motion: Motion, fps: float, seconds: float) -> NDArray[np.float64]:
    """Positions (frames, 3) of one particle whose target moves so."""
    frames = round(seconds * fps) + 1
    positions = [motion(frame / fps)[None] for frame in range(frames)]
    return run(Springs([stiffness], [damping], 1 / fps), positions)[:, 0]


@pytest.mark.parametrize("ratio", [0.0, 0.05, 0.5, 0.999999, 1.0, 1.000001, 2.0, 1000.0])
def test_a_released_spring_swings_and_decays_as_the_equation_says(ratio: float) -> None:
    omega, dt, lag = 9.0, 1 / 24, 0.3
    springs = Springs([omega**2], [2 * ratio * omega], dt)
    rest = np.zeros((1, 3))
    springs.reset(rest)
    springs.step(rest, rest)
    state = springs.state()
    state.arrays[0][:] = [lag, 0, 0]  # pulled away, at rest
    springs.restore(state)
    for frame in range(1, 60):
        t = frame * dt
        x = springs.step(rest, rest)[0, 0]
        if ratio < 1:
            turn = omega * math.sqrt(1 - ratio**2)
            decay = ratio * omega
            expected = lag * math.exp(-decay * t) * (math.cos(turn * t) + decay / turn * math.sin(turn * t))
        elif ratio == 1:
            expected = lag * math.exp(-omega * t) * (1 + omega * t)
        else:
            root = math.sqrt(ratio**2 - 1)
            slow, fast = omega / (ratio + root), omega * (ratio + root)
            expected = lag * (fast * math.exp(-slow * t) - slow * math.exp(-fast * t)) / (fast - slow)
        # The textbook formula itself loses digits beside critical damping.
        assert x == pytest.approx(expected, abs=1e-9 * lag if abs(ratio - 1) < 1e-3 else 1e-13)


def test_critical_damping_is_nothing_special() -> None:
    rng = np.random.default_rng(0)
    motion = rng.normal(size=(20, 1, 3))
    at, below, above = (
        run(Springs([100.0], [20.0 * near], 1 / 30), motion) for near in (1.0, 1.0 - 1e-12, 1.0 + 1e-12)
    )
    np.testing.assert_allclose(below, at, rtol=0, atol=1e-11)
    np.testing.assert_allclose(above, at, rtol=0, atol=1e-11)


def test_a_steady_target_is_followed_without_lag() -> None:
    rng = np.random.default_rng(1)
    start, velocity = rng.normal(size=(2, 50, 3))
    motion = np.array([start + velocity * frame / 24 for frame in range(40)])
    stiffness, damping = 10 ** rng.uniform(-6, 8, size=(2, 50))
    np.testing.assert_allclose(run(Springs(stiffness, damping, 1 / 24), motion), motion, rtol=0, atol=1e-11)


def test_a_still_target_is_left_alone_to_the_bit() -> None:
    rng = np.random.default_rng(2)
    motion = np.repeat(rng.normal(size=(1, 50, 3)), 30, axis=0)
    stiffness, damping = 10 ** rng.uniform(-12, 12, size=(2, 50))
    np.testing.assert_array_equal(run(Springs(stiffness, damping, 1 / 24), motion), motion)


def test_under_constant_acceleration_the_lag_settles_at_acceleration_over_stiffness() -> None:
    acceleration, stiffness = np.array([0.0, 0.0, -9.81]), 400.0
    positions = one_particle(stiffness, 30.0, lambda t: acceleration * t * t / 2, 24, 5)
    last = 24 * 5 - 1  # at the very end the target's slope is one-sided
    lag = positions[last] - acceleration * (last / 24) ** 2 / 2
    np.testing.assert_allclose(lag, -acceleration / stiffness, rtol=0, atol=1e-10)


def test_without_stiffness_and_damping_a_particle_flies_on() -> None:
    rng = np.random.default_rng(3)
    motion = rng.normal(size=(30, 20, 3))
    result = run(Springs(np.zeros(20), np.zeros(20), 1 / 24), motion)
    velocity = motion[1] - motion[0]
    expected = motion[0] + velocity * np.arange(30)[:, None, None]
    np.testing.assert_allclose(result, expected, rtol=0, atol=1e-11)


def test_infinitely_stiff_springs_follow_the_target() -> None:
    t = np.linspace(0, 1, 25)
    motion = np.stack([np.sin(t), np.cos(3 * t), t**2], axis=1)[:, None]
    for stiffness, damping in ((1e12, 0.0), (1e12, 1e6), (1e12, 1e12), (0.0, 1e12)):
        result = run(Springs([stiffness], [damping], 1 / 24), motion)
        np.testing.assert_allclose(result, motion, rtol=0, atol=1e-10)


def test_pinned_vertices_are_the_reference_bit_for_bit() -> None:
    rng = np.random.default_rng(4)
    motion = rng.normal(size=(10, 33, 3))
    pinned = rng.random(33) < 0.5
    result = run(Springs(np.full(33, 50.0), np.full(33, 1.0), 1 / 24, pinned), motion)
    np.testing.assert_array_equal(result[:, pinned], motion[:, pinned])
    assert np.abs(result - motion)[2:, ~pinned].min() > 0


def test_a_copy_a_hundred_times_larger_moves_a_hundred_times_as_far() -> None:
    rng = np.random.default_rng(5)
    motion = rng.normal(size=(40, 30, 3))
    stiffness, damping = rng.uniform(10, 2000, 30), rng.uniform(0, 30, 30)
    small = run(Springs(stiffness, damping, 1 / 24), motion)
    large = run(Springs(stiffness, damping, 1 / 24), 100 * motion)
    np.testing.assert_allclose(large, 100 * small, rtol=0, atol=1e-12 * np.abs(large).max())
    np.testing.assert_array_equal(run(Springs(stiffness, damping, 1 / 24), 128 * motion), 128 * small)


def test_turning_and_moving_the_reference_turns_and_moves_the_result() -> None:
    rng = np.random.default_rng(6)
    motion = rng.normal(size=(40, 30, 3))
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    stiffness, damping = rng.uniform(10, 2000, 30), rng.uniform(0, 30, 30)
    result = run(Springs(stiffness, damping, 1 / 24), motion)
    moved = run(Springs(stiffness, damping, 1 / 24), motion @ turn.T + 5.0)
    np.testing.assert_allclose(moved, result @ turn.T + 5.0, rtol=0, atol=1e-11)


def test_frame_rates_agree_in_seconds_ever_closer() -> None:
    def motion(t: float) -> NDArray[np.float64]:
        from_rest = 1 - math.exp(-((3 * t) ** 3))
        return from_rest * np.array([math.sin(5 * t), 0.5 * math.cos(3 * t), 0.2 * math.sin(9 * t)])

    seconds = 2.0
    truth = one_particle(300.0, 6.0, motion, 3840, seconds + 1)[round(seconds * 3840)]
    errors = {}
    for fps in (24, 30, 60, 120):
        positions = one_particle(300.0, 6.0, motion, fps, seconds + 1)
        errors[fps] = float(np.linalg.norm(positions[round(seconds * fps)] - truth))
    assert errors[24] < 1e-3
    assert errors[30] < errors[24] / 1.5
    assert errors[60] < errors[30] / 4
    assert errors[120] < errors[60] / 4


def test_29_97_frames_a_second_agree_with_30() -> None:
    def motion(t: float) -> NDArray[np.float64]:
        return np.array([math.sin(5 * t), 0.0, 0.2 * math.sin(9 * t)])

    fps = 30 / 1.001
    positions = one_particle(300.0, 6.0, motion, fps, 3.0)
    others = one_particle(300.0, 6.0, motion, 30, 3.0)
    times, other_times = np.arange(len(positions)) / fps, np.arange(len(others)) / 30
    at = np.linspace(0.5, 2.8, 100)
    for axis in range(3):
        np.testing.assert_allclose(
            np.interp(at, times, positions[:, axis]), np.interp(at, other_times, others[:, axis]), atol=0.01
        )


def test_without_knowing_the_next_frame_the_motion_is_nearly_the_same() -> None:
    t = np.arange(60) / 60
    motion = np.stack([np.sin(4 * t), np.cos(2 * t), t**2], axis=1)[:, None]
    informed = run(Springs([200.0], [5.0], 1 / 60), motion)
    springs = Springs([200.0], [5.0], 1 / 60)
    springs.reset(motion[0])
    blind = np.array([motion[0], *(springs.step(frame) for frame in motion[1:])])
    difference = np.abs(blind - informed).max()
    assert 0 < difference < 2e-3


def test_sub_frames_lie_on_the_path() -> None:
    rng = np.random.default_rng(7)
    motion = rng.normal(size=(5, 10, 3))
    springs = Springs(np.full(10, 400.0), np.full(10, 3.0), 1 / 24)
    springs.reset(motion[0])
    springs.step(motion[1], motion[2])
    start = springs.state().arrays[0]
    np.testing.assert_allclose(springs.evaluate(0.0, motion[2], motion[3]), start, atol=1e-13)
    nearly = springs.evaluate(1 - 1e-9, motion[2], motion[3])
    end = springs.evaluate(1.0, motion[2], motion[3])
    np.testing.assert_allclose(nearly, end, atol=1e-7)
    np.testing.assert_allclose(springs.step(motion[2], motion[3]), end, atol=1e-12)


def test_a_restored_state_resumes_bit_for_bit_even_in_another_solver() -> None:
    rng = np.random.default_rng(8)
    motion = rng.normal(size=(12, 40, 3))
    stiffness, damping = 10 ** rng.uniform(-3, 6, size=(2, 40))
    whole = run(Springs(stiffness, damping, 1 / 24), motion)
    first, second = Springs(stiffness, damping, 1 / 24), Springs(stiffness, damping, 1 / 24)
    first.reset(motion[0])
    for frame in range(1, 6):
        first.step(motion[frame], motion[frame + 1])
    second.restore(first.state())
    for frame in range(6, 12):
        ahead = motion[frame + 1] if frame < 11 else None
        np.testing.assert_array_equal(second.step(motion[frame], ahead), whole[frame])


def test_the_result_belongs_to_the_caller() -> None:
    springs = Springs([100.0], [1.0], 1 / 24)
    springs.reset(np.zeros((1, 3)))
    first = springs.step(np.ones((1, 3)))
    kept = first.copy()
    springs.step(np.full((1, 3), 2.0))
    np.testing.assert_array_equal(first, kept)
    first[:] = np.nan
    assert np.isfinite(springs.step(np.ones((1, 3)))).all()


@pytest.mark.parametrize("seed", range(20))
def test_any_constants_at_any_step_stay_finite(seed: int) -> None:
    rng = np.random.default_rng(seed)
    count = 500
    stiffness, damping = 10 ** rng.uniform(-30, 30, size=(2, count))
    stiffness[rng.random(count) < 0.1] = 0
    damping[rng.random(count) < 0.1] = 0
    motion = rng.normal(size=(40, count, 3)) * 10 ** rng.uniform(-6, 6)
    result = run(Springs(stiffness, damping, 10 ** rng.uniform(-4, 1)), motion)
    assert np.isfinite(result).all()


def test_results_do_not_depend_on_threads_or_instruction_sets() -> None:
    script = (
        "import hashlib, numpy as np\n"
        "from followthrough.springs import Springs\n"
        "rng = np.random.default_rng(0)\n"
        "n = 200001\n"
        "springs = Springs(rng.uniform(0, 1e4, n), rng.uniform(0, 100, n), 1 / 24, rng.random(n) < 0.1)\n"
        "motion = rng.normal(size=(4, n, 3))\n"
        "springs.reset(motion[0])\n"
        "results = [springs.step(motion[f], motion[(f + 1) % 4]) for f in (1, 2, 3)]\n"
        "print(hashlib.sha256(b''.join(r.tobytes() for r in results)).hexdigest())\n"
    )
    hashes = set()
    for threads, instructions in (("1", ""), ("2", ""), ("4", ""), ("2", "baseline"), ("1", "avx2"), ("1", "avx512")):
        environment = {**os.environ, "OMP_NUM_THREADS": threads, "FOLLOWTHROUGH_INSTRUCTION_SET": instructions}
        environment["PYTHONPATH"] = os.pathsep.join(sys.path)
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        hashes.add(done.stdout)
    assert len(hashes) == 1


def test_input_that_cannot_be_used_is_refused_by_name() -> None:
    good = np.full(4, 10.0)
    with pytest.raises(ValueError, match=r"stiffness: found -1.*vertex 2"):
        Springs([1, 1, -1, 1], good, 0.1)
    with pytest.raises(ValueError, match=r"damping: found nan"):
        Springs(good, [1, np.nan, 1, 1], 0.1)
    with pytest.raises(ValueError, match="damping"):
        Springs(good, good[:3], 0.1)
    with pytest.raises(ValueError, match=r"stiffness: found shape \(4, 1\)"):
        Springs(good[:, None], good, 0.1)
    with pytest.raises(ValueError, match="stiffness: found an array of complex128"):
        Springs(good * 1j, good, 0.1)
    for dt in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match="dt"):
            Springs(good, good, dt)
    with pytest.raises(ValueError, match=r"pinned: found shape \(3,\)"):
        Springs(good, good, 0.1, np.zeros(3, dtype=bool))
    with pytest.raises(ValueError, match=r"pinned: .*int"):
        Springs(good, good, 0.1, [0, 1, 0, 1])

    springs = Springs(good, good, 0.1)
    with pytest.raises(ValueError, match="reset"):
        springs.step(np.zeros((4, 3)))
    springs.reset(np.zeros((4, 3)))
    springs.step(np.ones((4, 3)))
    before = springs.state()
    for wrong in bad_positions(np.zeros((4, 3))):
        with pytest.raises(ValueError, match="reference"):
            springs.step(wrong)
        with pytest.raises(ValueError, match="reference"):
            springs.step(np.zeros((4, 3)), wrong)
        with pytest.raises(ValueError, match="reference"):
            springs.reset(wrong)
    with pytest.raises(ValueError, match="fraction"):
        springs.evaluate(1.5, np.zeros((4, 3)))
    after = springs.state()
    assert after.frames == before.frames
    for a, b in zip(after.arrays, before.arrays, strict=True):
        np.testing.assert_array_equal(a, b)


def test_arrays_of_other_types_and_layouts_are_taken() -> None:
    springs, other = Springs([100, 100], [1, 1], 0.1), Springs([100.0, 100.0], [1.0, 1.0], 0.1)
    springs.reset(np.zeros((2, 3), dtype=np.float32))
    other.reset(np.zeros((2, 3)))
    target = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(springs.step(np.asfortranarray(target)), other.step(target))
    np.testing.assert_array_equal(springs.step([[1, 2, 3], [4, 5, 6]]), other.step(target + 1))
