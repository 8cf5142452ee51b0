# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes reference_derivatives.inc and reference_losses.inc: derivatives of the spring's factors, and of the loss of a whole
motion, by central differences of textbook formulas in 600 digits. Needs mpmath."""

import itertools
import sys
from collections.abc import Callable
from pathlib import Path

import mpmath
from make_reference_coefficients import factors_of

mpmath.mp.dps = 600
STEP = mpmath.mpf(10) ** -200  # of the logarithm; differences are then right to 400 digits
DURATION = mpmath.mpf(1 / 24)


def by_logarithm(function: Callable[[mpmath.mpf], list[mpmath.mpf]], value: float) -> list[mpmath.mpf]:
    """The derivatives of a function of one positive number with respect to its logarithm."""
    up, down = (function(mpmath.mpf(value) * mpmath.exp(sign * STEP)) for sign in (1, -1))
    return [(a - b) / (2 * STEP) for a, b in zip(up, down, strict=True)]


def plane() -> list[tuple[float, float]]:
    """Constants all over the plane, on the critical line and beside it."""
    stiff = [10.0**e for e in range(-6, 13, 2)] + [0.3, 30.0, 300.0, 3e3]
    rows = list(itertools.product(stiff, [10.0**e for e in range(-6, 9, 2)] + [0.3, 30.0, 300.0, 3e3]))
    for frequency in (1e-3, 1.0, 30.0, 60.0, 1e3, 1e6):
        for nearness in (-0.1, -1e-3, -1e-9, -1e-15, 0.0, 1e-12, 1e-6, 1e-2, 0.1):
            rows.append((frequency * frequency, 2.0 * frequency * (1.0 + nearness)))
    return rows


def motion() -> tuple[list[mpmath.mpf], list[mpmath.mpf]]:
    """Reference and wanted positions of 12 frames along one axis: integers over 64, exact as doubles."""
    reference = [0, 0, 3, 11, 20, 18, 7, 7, -4, -20, -11, 2]
    lag = [0, -1, -2, -5, -3, 2, 6, 1, 4, 5, -7, -3]
    positions = [mpmath.mpf(r) / 64 for r in reference]
    return positions, [p + mpmath.mpf(w) / 64 for p, w in zip(positions, lag, strict=True)]


def loss(stiffness: mpmath.mpf, damping: mpmath.mpf) -> mpmath.mpf:
    """[ZS] eq. 14 of that motion."""
    reference, wanted = motion()
    last = len(reference) - 1
    slopes = [
        (reference[min(n + 1, last)] - reference[max(n - 1, 0)]) / (1 if n in (0, last) else 2) for n in range(last + 1)
    ]
    decay, impulse, slope, restoring, acceleration, acceleration_slope = factors_of(stiffness, damping, DURATION)
    lag = rate = total = mpmath.mpf(0)
    for n in range(last):
        bend = slopes[n] + slopes[n + 1] - 2 * (reference[n + 1] - reference[n])
        turn = slopes[n + 1] - slopes[n]
        constant, linear = turn - 3 * bend, 6 * bend  # the target's acceleration, a frame squared
        lag, rate = (
            decay * lag + impulse * rate - acceleration * constant - acceleration_slope * linear,
            slope * rate - restoring * lag - impulse * constant - acceleration * linear,
        )
        total += (lag - (wanted[n + 1] - reference[n + 1])) ** 2
    return total


def write(name: str, rows: list[tuple[float, ...]]) -> None:
    """One initializer a line."""
    with (Path(__file__).parent / name).open("w") as out:
        out.write("// SPDX-License-Identifier: GPL-3.0-or-later\n// Written by make_reference_derivatives.py.\n")
        for row in rows:
            out.write("{" + ", ".join(f"{float(value)!r}" for value in row) + "},\n")


def main() -> None:
    derivatives, losses = [], []
    for ks, kd in plane():
        by_ks = by_logarithm(lambda k, kd=kd: factors_of(k, mpmath.mpf(kd), DURATION), ks)
        by_kd = by_logarithm(lambda k, ks=ks: factors_of(mpmath.mpf(ks), k, DURATION), kd)
        derivatives.append((ks, kd, *by_ks, *by_kd))
        (loss_by_ks,) = by_logarithm(lambda k, kd=kd: [loss(k, mpmath.mpf(kd))], ks)
        (loss_by_kd,) = by_logarithm(lambda k, ks=ks: [loss(mpmath.mpf(ks), k)], kd)
        losses.append((ks, kd, loss(mpmath.mpf(ks), mpmath.mpf(kd)), loss_by_ks, loss_by_kd))
    write("reference_derivatives.inc", derivatives)
    write("reference_losses.inc", losses)
    print(len(losses), "rows", file=sys.stderr)


if __name__ == "__main__":
    main()
