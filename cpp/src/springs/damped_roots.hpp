// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The roots of s^2 + kd s + ks, and the means of exponentials that both a spring's factors and their derivatives are made of,
/// without cancellation.
#pragma once

#include <cmath>

namespace followthrough {

// Beyond these the particle cannot leave its target by more than the smallest numbers; keeps squares from overflowing.
inline constexpr double largest_stiffness = 1e290;
inline constexpr double largest_damping = 1e145;

// Below these power series in time converge fast; above, the closed forms lose no more than a digit. Both times the duration.
inline constexpr double series_damping = 2.0;
inline constexpr double series_stiffness = 2.0;

/// A number as an unevaluated sum, so that the phase of a stiff spring (thousands of turns a frame) keeps its digits.
struct TwoPart {
  double high;
  double low;
};

/// g^2 - ks without cancellation.
inline TwoPart discriminant(double half_damping, double stiffness) {
  const double square = half_damping * half_damping;
  const double square_rest = std::fma(half_damping, half_damping, -square);
  const double high = square - stiffness;
  const double part = high - square;
  const double rest = (square - (high - part)) + (-stiffness - part);
  const double low = rest + square_rest;
  const double sum = high + low;
  return {sum, (high - sum) + low};
}

/// sqrt(d) * duration for d > 0.
inline TwoPart root_times(TwoPart d, double duration) {
  const double root = std::sqrt(d.high);
  const double root_rest = root > 0.0 ? (std::fma(-root, root, d.high) + d.low) / (2.0 * root) : 0.0;
  const double high = root * duration;
  return {high, std::fma(root, duration, -high) + root_rest * duration};
}

/// Cosine and sine of a phase in two parts.
struct Turn {
  double cosine;
  double sine;
};

inline Turn turn_of(TwoPart phase) {
  if (phase.high > 1e15) {
    phase.low = 0.0;  // not even the turn is known any more: any phase will do, but it must be one
  }
  return {std::cos(phase.high) - phase.low * std::sin(phase.high), std::sin(phase.high) + phase.low * std::cos(phase.high)};
}

/// (1 - e^-x) / x: the mean of e^-xt over t from 0 to 1.
inline double mean_of_exponential(double x) { return x > 0.0 ? -std::expm1(-x) / x : 1.0; }

/// (x - 1 + e^-x) / x^2: the mean of (1 - t) e^-xt.
inline double mean_of_mean_of_exponential(double x) {
  if (x >= 1.0) {
    return (1.0 + std::expm1(-x) / x) / x;
  }
  double term = 0.5;
  double sum = term;
  for (int k = 3; k < 20; ++k) {
    term *= -x / k;
    sum += term;
  }
  return sum;
}

}  // namespace followthrough
