# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds the coefficients of the emulator's tanhs, x P(x²) / Q(x²), and measures them in single precision.

The least maximal error by iteratively reweighted linear least squares (Lawson's method) on tanh(x) Q(x²) - x P(x²), with P(0) = Q(0) = 1
so that small arguments keep their relative precision. `python tests/cpp/emulator/fit_tanh.py` prints P and Q from the constant on.
"""

from __future__ import annotations

import numpy as np

# Limit, beyond which it is 1, and degrees of P and Q in x². The second is bfloat16's, where a reciprocal that is off by 2⁻¹⁴
# stands for the division.
FITS = ((8.0, 5, 3), (5.2, 2, 2))


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


def main() -> None:
    """Print the coefficients and the errors."""
    x = np.concatenate([np.linspace(-12, 12, 4_000_001), np.logspace(-12, 0, 200_001)]).astype(np.float32)
    exact = np.tanh(x.astype(np.float64))
    for limit, numerator, denominator in FITS:
        error, p, q = fit(limit, numerator, denominator)
        print(f"x P(x²) / Q(x²) on [-{limit}, {limit}], off by {error:.2g} in exact arithmetic")
        for name, polynomial in (("P", p), ("Q", q)):
            print(name, ", ".join(float(np.float32(c)).hex() for c in polynomial))
        for fused in (True, False):
            off = np.abs(in_single_precision(limit, p, q, x, fused) - exact)
            relative = (off / np.where(exact == 0, 1, np.abs(exact))).max()
            print(f"{'fused' if fused else 'plain'}: off by {off.max():.2g}, relatively {relative:.2g}")


if __name__ == "__main__":
    main()
