# SPDX-License-Identifier: GPL-3.0-or-later
"""Learning springs natively beside a straight Python implementation of [ZS] section 6: the same loss, frame by frame, and derivatives by
differences, minimized by the same kind of search. `spring_fit_time.py [VERTICES]`; the Python part does a few of them.
"""

from __future__ import annotations

import math
import sys
import time

import numpy as np
from numpy.typing import NDArray

from followthrough.spring_fit import Training, fit_springs
from followthrough.springs import Springs

FRAMES, DT, PLAIN_VERTICES = 100, 1 / 24, 3
Array = NDArray[np.float64]


def waves(count: int) -> Array:
    """Motion (FRAMES, count, 3) of several frequencies."""
    random = np.random.default_rng(1)
    motion = np.zeros((FRAMES, count, 3))
    time_of = DT * np.arange(FRAMES)[:, None, None]
    for _ in range(4):
        size, rate, phase = (
            random.normal(0, 0.1, (count, 3)),
            random.uniform(1, 13, (count, 3)),
            random.uniform(0, 6, (count, 3)),
        )
        motion += size * np.sin(rate * time_of + phase)
    return motion


def motion_of(reference: Array, stiffness: Array, damping: Array) -> Array:
    """What springs do with it."""
    springs = Springs(stiffness, damping, DT)
    frames = [springs.reset(reference[0])]
    for frame in range(1, FRAMES):
        frames.append(springs.step(reference[frame], reference[frame + 1] if frame + 1 < FRAMES else None))
    return np.array(frames)


def plain_loss(reference: Array, dynamic: Array, log_stiffness: float, log_damping: float) -> float:
    """[ZS] eqs. 7 to 14 of one vertex (F, 3), in Python and NumPy."""
    ks, kd = math.exp(log_stiffness), math.exp(log_damping)
    slopes = np.gradient(reference, DT, axis=0)
    position, velocity, loss = reference[0].copy(), slopes[0].copy(), 0.0
    root = kd * kd / 4 - ks
    size = math.sqrt(abs(root)) * DT
    decay = math.exp(-kd * DT / 2)
    if root < 0:
        even, odd = math.cos(size), math.sin(size) / size
    else:
        even, odd = math.cosh(size), math.sinh(size) / size if size > 0 else 1.0
    for n in range(FRAMES - 1):
        mean = (reference[n + 1] - reference[n]) / DT
        bend = slopes[n] + slopes[n + 1] - 2 * mean
        cubic, square = bend / DT**2, (mean - slopes[n] - bend) / DT

        def particular(t: float, n: int = n, cubic: Array = cubic, square: Array = square) -> tuple[Array, Array]:
            target = reference[n] + t * (slopes[n] + t * (square + t * cubic))
            speed = slopes[n] + t * (2 * square + 3 * t * cubic)
            acceleration, jerk = 2 * square + 6 * t * cubic, 6 * cubic
            return target - acceleration / ks + kd * jerk / ks**2, speed - jerk / ks

        start, start_rate = particular(0.0)
        end, end_rate = particular(DT)
        one = position - start
        two = velocity + kd / 2 * one - start_rate
        position = end + decay * (even * one + odd * DT * two)
        change = (root * DT * odd) * one + even * two
        velocity = end_rate + decay * change - kd / 2 * decay * (even * one + odd * DT * two)
        loss += float(np.sum((position - dynamic[n + 1]) ** 2))
    return loss


def plain_fit(reference: Array, dynamic: Array, seed: int) -> tuple[float, float]:
    """A genetic algorithm of 24 members and 4 generations, then gradient descent with a line search, as the paper has it."""
    random = np.random.default_rng(seed)

    def value(at: Array) -> float:
        try:
            loss = plain_loss(reference, dynamic, at[0], at[1])
        except OverflowError:
            return math.inf
        return loss if math.isfinite(loss) else math.inf

    members = np.column_stack([random.uniform(0, 12, 24), random.uniform(-2, 8, 24)])
    for generation in range(4):
        members = members[np.argsort([value(member) for member in members])]
        if generation < 3:
            for place in range(4, 24):
                mother, father = members[random.integers(0, 8, 2)]
                members[place] = mother + random.uniform(-0.25, 1.25, 2) * (father - mother) + random.normal(0, 0.6, 2)
    at, rate = members[0], 0.1
    loss = value(at)
    for _ in range(60):
        step = 1e-6
        gradient = np.array([value(at + step * axis) - value(at - step * axis) for axis in np.eye(2)]) / (2 * step)
        size = float(np.linalg.norm(gradient))
        if size == 0.0:
            break
        while rate > 1e-8:
            there = at - rate * gradient / size
            now = value(there)
            if now < loss:
                at, loss, rate = there, now, 2 * rate
                break
            rate /= 3
        else:
            break
    return math.exp(at[0]), math.exp(at[1])


def main() -> None:
    """Print both times a vertex and their ratio."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 14000
    random = np.random.default_rng(2)
    stiffness = 10 ** random.uniform(1, 3.5, count)
    damping = 2 * 10 ** random.uniform(-1.5, 0.5, count) * np.sqrt(stiffness)
    reference = waves(count)
    dynamic = motion_of(reference, stiffness, damping)
    begun = time.perf_counter(), time.process_time()
    fit = fit_springs([Training(reference, dynamic, DT)])
    wall, native = time.perf_counter() - begun[0], time.process_time() - begun[1]
    begun_plain = time.process_time()
    found = [plain_fit(reference[:, v], dynamic[:, v], v) for v in range(PLAIN_VERTICES)]
    plain = (time.process_time() - begun_plain) / PLAIN_VERTICES
    off = [max(abs(ks / stiffness[v] - 1), abs(kd / damping[v] - 1)) for v, (ks, kd) in enumerate(found)]
    worst = max(np.abs(fit.stiffness / stiffness - 1).max(), np.abs(fit.damping / damping - 1).max())
    print(
        f"native: {count} vertices, {FRAMES} frames in {wall:.2f} s, {1e6 * native / count:.0f} us of processor time a vertex; "
        f"worst constant off by {worst:.1e}"
    )
    print(f"plain Python: {1e3 * plain:.0f} ms of processor time a vertex; worst constant off by {max(off):.1e}")
    print(f"ratio of processor times: {plain * count / native:.0f}")


if __name__ == "__main__":
    main()
