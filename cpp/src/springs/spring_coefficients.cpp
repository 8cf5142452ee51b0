// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_coefficients.hpp"

#include <algorithm>
#include <cmath>

#include "springs/damped_roots.hpp"

namespace followthrough {
namespace {

constexpr int series_terms = 30;

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
    const TwoPart phase = root_times({-d.high, -d.low}, duration);
    const auto [cosine, sine] = turn_of(phase);
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
