// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_coefficients.hpp"

#include <algorithm>
#include <cmath>

namespace followthrough {
namespace {

// Beyond these the particle cannot leave its target by more than the smallest numbers; keeps squares from overflowing.
constexpr double largest_stiffness = 1e290;
constexpr double largest_damping = 1e145;

// Below these power series converge fast; above, the closed forms lose no more than a digit.
constexpr double series_damping = 2.0;
constexpr double series_stiffness = 2.0;
constexpr int series_terms = 30;

// A number as an unevaluated sum, so that the phase of a stiff spring (thousands of turns a frame) keeps its digits.
struct TwoPart {
  double high;
  double low;
};

// g^2 - ks without cancellation.
TwoPart discriminant(double half_damping, double stiffness) {
  const double square = half_damping * half_damping;
  const double square_rest = std::fma(half_damping, half_damping, -square);
  const double high = square - stiffness;
  const double part = high - square;
  const double rest = (square - (high - part)) + (-stiffness - part);
  const double low = rest + square_rest;
  const double sum = high + low;
  return {sum, (high - sum) + low};
}

// sqrt(d) * duration for d > 0.
TwoPart root_times(TwoPart d, double duration) {
  const double root = std::sqrt(d.high);
  const double root_rest = root > 0.0 ? (std::fma(-root, root, d.high) + d.low) / (2.0 * root) : 0.0;
  const double high = root * duration;
  return {high, std::fma(root, duration, -high) + root_rest * duration};
}

// (1 - e^-x) / x
double mean_of_exponential(double x) { return x > 0.0 ? -std::expm1(-x) / x : 1.0; }

// (x - 1 + e^-x) / x^2
double mean_of_mean_of_exponential(double x) {
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

// Taylor series of G in time: weak springs, any regime. Needs no division by the constants.
SpringCoefficients from_series(double stiffness, double damping) {
  double before = 0.0;  // the derivatives of G at 0, each divided by the factorial of its order
  double derivative = 1.0;
  double impulse = 0.0, impulse_slope = 0.0, acceleration = 0.0, acceleration_slope = 0.0;
  for (int order = 1; order <= series_terms; ++order) {
    impulse_slope += derivative * order;
    impulse += derivative;
    acceleration += derivative / (order + 1);
    acceleration_slope += derivative / ((order + 1) * (order + 2));
    const double after = -(damping * derivative + stiffness * before / order) / (order + 1);
    before = derivative;
    derivative = after;
  }
  return {1.0 - stiffness * acceleration, impulse, impulse_slope, stiffness * impulse, acceleration, acceleration_slope};
}

}  // namespace

SpringCoefficients spring_coefficients(double stiffness, double damping, double duration) noexcept {
  stiffness = std::min(stiffness, largest_stiffness);
  damping = std::min(damping, largest_damping);
  const double ks = std::min(stiffness * duration * duration, largest_stiffness);
  const double kd = std::min(damping * duration, largest_damping);
  if (kd <= series_damping && ks <= series_stiffness) {
    return from_series(ks, kd);
  }
  const double half = 0.5 * kd;
  const TwoPart d = discriminant(0.5 * damping, stiffness);
  SpringCoefficients k{};
  bool far_roots = false;
  if (d.high >= 0.0) {
    // Two decays. The slow rate comes from the product of the rates: half - root would cancel.
    const TwoPart root = root_times(d, duration);
    const double fast = half + root.high;
    const double slow = ks / fast;
    const double gap = 2.0 * root.high;
    const double slow_decay = std::exp(-slow);
    const double fast_decay = std::exp(-fast);
    k.impulse = slow_decay * mean_of_exponential(gap);
    k.decay = slow_decay + slow * k.impulse;
    k.impulse_slope = fast_decay - slow * k.impulse;
    far_roots = fast > 1.5 * slow;
    if (far_roots) {
      k.acceleration = (mean_of_exponential(slow) - mean_of_exponential(fast)) / gap;
      k.acceleration_slope = (mean_of_mean_of_exponential(slow) - mean_of_mean_of_exponential(fast)) / gap;
    }
  } else {
    TwoPart phase = root_times({-d.high, -d.low}, duration);
    if (phase.high > 1e15) {
      phase.low = 0.0;  // not even the turn is known any more: any phase will do, but it must be one
    }
    const double cosine = std::cos(phase.high) - phase.low * std::sin(phase.high);
    const double sine = std::sin(phase.high) + phase.low * std::cos(phase.high);
    const double envelope = std::exp(-half);
    k.impulse = envelope * (sine / phase.high);
    k.decay = envelope * cosine + half * k.impulse;
    k.impulse_slope = envelope * cosine - half * k.impulse;
  }
  k.restoring = ks * k.impulse;
  if (!far_roots) {
    // The equation integrated once and twice; here its constants are large enough to divide by.
    k.acceleration = (1.0 - k.decay) / ks;
    k.acceleration_slope = (1.0 - k.impulse - kd * k.acceleration) / ks;
  }
  return k;
}

}  // namespace followthrough
