# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the coefficients of the emulator's tanhs and measures them in single precision.

In single precision it is x P(x²) / Q(x²): the least maximal error by iteratively reweighted linear least squares (Lawson's method) on
tanh(x) Q(x²) - x P(x²), with P(0) = Q(0) = 1 so that small arguments keep their relative precision. In bfloat16 it is one of 16 parabolas,
that of the two leading digits after the point and the last four of the exponent of |x| + 0.3125 as a float: short pieces where tanh
bends, long ones where it does not. `python tests/cpp/emulator/fit_tanh.py` prints all coefficients from the constant on.
"""

from __future__ import annotations

import numpy as np

# Limit, beyond which it is 1, and degrees of P and Q in x².
LIMIT, NUMERATOR, DENOMINATOR = 8.0, 5, 3
# What is added to |x|, and how many of a float's last digits do not count.
SHIFT, DIGITS = np.float32(0.3125), 21
# The largest float that stays in the last piece; beyond it the parabolas stand still.
END = np.nextafter(np.float32(5.0), np.float32(0)) - SHIFT
# Where the third derivative of tanh changes its sign: up to here, pieces that need not meet would step down at their ends.
TURN = 0.66


def fit(limit: float, numerator: int, denominator: int, rounds: int = 400) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the maximal error and the coefficients of P and Q."""
    x = limit * np.sin(np.pi / 2 * (np.arange(4001) + 0.5) / 4001)
    y, exact = (x / limit) ** 2, np.tanh(x)
    weight, q_values = np.ones_like(x), np.ones_like(x)
    best = (np.inf, np.ones(1), np.ones(1))
    p_powers, q_powers = (y[:, None] ** np.arange(degree + 1) for degree in (numerator, denominator))
    for _ in range(rounds):
        scale = np.sqrt(weight) / q_values
        unknown = np.concatenate([x[:, None] * p_powers[:, 1:], -exact[:, None] * q_powers[:, 1:]], axis=1)
        solution = np.linalg.lstsq(unknown * scale[:, None], (exact - x) * scale, rcond=None)[0]
        p, q = np.concatenate([[1], solution[:numerator]]), np.concatenate([[1], solution[numerator:]])
        q_values = q_powers @ q
        error = np.abs(x * (p_powers @ p) / q_values - exact)
        if error.max() < best[0]:
            best = (error.max(), p / limit ** (2 * np.arange(len(p))), q / limit ** (2 * np.arange(len(q))))
        weight *= error / error.max()
        weight /= weight.mean()
    return best


def in_single_precision(limit: float, p: np.ndarray, q: np.ndarray, x: np.ndarray, fused: bool) -> np.ndarray:
    """What the kernels compute, with fused multiply-adds or without."""
    x = np.clip(x.astype(np.float32), -np.float32(limit), np.float32(limit))
    y = x * x
    values = []
    for polynomial in (p, q):
        value = np.full_like(x, polynomial[-1])
        for coefficient in polynomial[-2::-1].astype(np.float32):
            if fused:
                value = (value.astype(np.float64) * y.astype(np.float64) + np.float64(coefficient)).astype(np.float32)
            else:
                value = value * y + coefficient
        values.append(value)
    return (x * values[0]) / values[1]


def parabolas() -> np.ndarray:
    """Return coefficients (3, 16) that meet tanh in three points of each piece, such that the whole never falls.

    Beyond TURN these are Chebyshev's, and pieces step up where they end by less than their error; before it they are the ends and one
    between them. In the first piece that one is where relative errors before and after it are the same.
    """
    table = np.zeros((3, 16))
    first = int(SHIFT.view(np.uint32)) >> DIGITS
    for piece in range(first, first + 16):
        low, high = (np.uint32(k << DIGITS).view(np.float32).astype(float) - float(SHIFT) for k in (piece, piece + 1))
        share = (1 - np.cos(np.pi * (np.arange(3) + 0.5) / 3)) / 2 if high > TURN else np.array([0, 0.5, 1])
        if piece == first:
            share[1] = 3 - np.sqrt(8)
        x = low + (high - low) * share
        table[:, piece % 16] = np.linalg.solve(x[:, None] ** np.arange(3), np.tanh(x))
    table[0, first % 16] = 0.0
    return table


def by_parabolas(table: np.ndarray, x: np.ndarray) -> np.ndarray:
    """What the kernels for bfloat16 compute, but for the rounding of fused multiply-adds."""
    size = np.minimum(np.abs(x), END)
    piece = ((size + SHIFT).view(np.uint32) >> DIGITS) % 16
    constant, slope, bend = table.astype(np.float32)[:, piece]
    return np.copysign((bend * size + slope) * size + constant, x)


def main() -> None:
    """Print the coefficients and the errors."""
    x = np.concatenate([np.linspace(-12, 12, 4_000_001), np.logspace(-12, 0, 200_001)]).astype(np.float32)
    exact = np.tanh(x.astype(np.float64))
    error, p, q = fit(LIMIT, NUMERATOR, DENOMINATOR)
    print(f"x P(x²) / Q(x²) on [-{LIMIT}, {LIMIT}], off by {error:.2g} in exact arithmetic")
    for name, polynomial in (("P", p), ("Q", q)):
        print(name, ", ".join(float(np.float32(c)).hex() for c in polynomial))
    for fused in (True, False):
        off = np.abs(in_single_precision(LIMIT, p, q, x, fused) - exact)
        relative = (off / np.where(exact == 0, 1, np.abs(exact))).max()
        print(f"{'fused' if fused else 'plain'}: off by {off.max():.2g}, relatively {relative:.2g}")
    table = parabolas()
    for row in table:
        print(", ".join(f"{np.float32(c):.8g}f" for c in row))
    off = np.abs(by_parabolas(table, x) - exact)
    relative = (off[exact != 0] / np.abs(exact[exact != 0])).max()
    print(f"parabolas up to {float(END):.9g}: off by {off.max():.2g}, relatively {relative:.2g}")
    rising = by_parabolas(table, np.sort(x))
    print(f"from {rising[0]:.8g} to {rising[-1]:.8g}, at most {max(-np.diff(rising).min(), 0):.2g} down")


if __name__ == "__main__":
    main()
