# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes reference_coefficients.inc: spring factors in 120 digits from the textbook formulas. Needs mpmath."""

import itertools
import sys
from pathlib import Path

import mpmath

mpmath.mp.dps = 120


def factors(stiffness: float, damping: float, duration: float) -> list[mpmath.mpf]:
    """decay, impulse, impulse_slope, restoring, acceleration, acceleration_slope of the doubles given, exactly."""
    return factors_of(mpmath.mpf(stiffness), mpmath.mpf(damping), mpmath.mpf(duration))


def factors_of(stiffness: mpmath.mpf, damping: mpmath.mpf, duration: mpmath.mpf) -> list[mpmath.mpf]:
    """The same of numbers of any precision."""
    ks = stiffness * duration**2
    kd = damping * duration
    if ks == 0 and kd == 0:
        return [mpmath.mpf(v) for v in (1, 1, 1, 0)] + [mpmath.mpf(1) / 2, mpmath.mpf(1) / 6]
    if ks == 0:
        decay = mpmath.exp(-kd)
        impulse = (1 - decay) / kd
        acceleration = (1 - impulse) / kd
        return [mpmath.mpf(1), impulse, decay, mpmath.mpf(0), acceleration, (mpmath.mpf(1) / 2 - acceleration) / kd]
    root = mpmath.sqrt(mpmath.mpc(kd**2 / 4 - ks))
    envelope = mpmath.exp(-kd / 2)
    sine = mpmath.sinh(root) / root if root != 0 else mpmath.mpf(1)
    impulse = (envelope * sine).real
    decay = (envelope * (mpmath.cosh(root) + kd / 2 * sine)).real
    slope = (envelope * (mpmath.cosh(root) - kd / 2 * sine)).real
    acceleration = (1 - decay) / ks
    return [decay, impulse, slope, ks * impulse, acceleration, (1 - impulse - kd * acceleration) / ks]


def main() -> None:
    duration = 1 / 24
    constants = [0.0] + [10.0**e for e in range(-12, 13, 2)] + [300.0]
    rows = list(itertools.product(constants, constants))
    for frequency in (1e-3, 1.0, 30.0, 60.0, 1e3):
        for nearness in (-1e-3, -1e-9, -1e-15, 0.0, 1e-12, 1e-6, 1e-2, 0.1):
            rows.append((frequency * frequency, 2.0 * frequency * (1.0 + nearness)))
    with (Path(__file__).parent / "reference_coefficients.inc").open("w") as out:
        out.write("// SPDX-License-Identifier: GPL-3.0-or-later\n// Written by make_reference_coefficients.py.\n")
        for stiffness, damping in rows:
            values = ", ".join(f"{float(v)!r}" for v in factors(stiffness, damping, duration))
            out.write(f"{{{stiffness!r}, {damping!r}, {values}}},\n")
    print(len(rows), "rows", file=sys.stderr)


if __name__ == "__main__":
    main()
