// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_derivatives.hpp"

#include <algorithm>
#include <cmath>

#include "springs/damped_roots.hpp"

namespace followthrough {
namespace {

constexpr int time_series_terms = 36;
constexpr int critical_series_terms = 14;
// Where the discriminant times the duration squared is smaller than this, H is summed as a series in it.
constexpr double series_discriminant = 1.0;

// H and what belongs to it, for a duration of 1.
struct DoubleResponse {
  double value;           // H
  double slope;           // H'
  double curvature;       // H''
  double integral;        // ks J1
  double integral_alone;  // J1, the integral of H
  double mean;            // J2, the integral of J1
};

// The mean of t e^-xt over t from 0 to 1: (1 - (1 + x) e^-x) / x^2.
double mean_of_ramp(double x) {
  if (x >= 1.0) {
    return (mean_of_exponential(x) - std::exp(-x)) / x;
  }
  double term = 1.0;  // (-x)^k / k!
  double sum = 0.5;
  for (int k = 1; k < 20; ++k) {
    term *= -x / k;
    sum += term / (k + 2);
  }
  return sum;
}

// The mean of t (1 - t) e^-xt: ((x - 2) + (x + 2) e^-x) / x^3.
double mean_of_arch(double x) {
  if (x >= 2.0) {
    return ((x - 2.0) + (x + 2.0) * std::exp(-x)) / x / x / x;
  }
  double term = 1.0;
  double sum = 1.0 / 6.0;
  for (int k = 1; k < 26; ++k) {
    term *= -x / k;
    sum += term / ((k + 2) * (k + 3));
  }
  return sum;
}

// Taylor series in time of H'' + kd H' + ks H = G: weak springs, any regime.
DoubleResponse from_time_series(double ks, double kd) {
  double g0 = 0.0, g1 = 1.0;  // the terms of G of orders k and k + 1
  double h0 = 0.0, h1 = 0.0;  // those of H
  DoubleResponse sums{};
  for (int k = 0; k < time_series_terms; ++k) {
    const double orders = (k + 2.0) * (k + 1.0);
    const double h2 = (g0 - kd * (k + 1) * h1 - ks * h0) / orders;
    const double g2 = -(kd * (k + 1) * g1 + ks * g0) / orders;
    sums.value += h2;
    sums.slope += (k + 2) * h2;
    sums.curvature += orders * h2;
    sums.integral_alone += h2 / (k + 3);
    sums.mean += h2 / ((k + 3.0) * (k + 4.0));
    g0 = g1;
    g1 = g2;
    h0 = h1;
    h1 = h2;
  }
  sums.integral = ks * sums.integral_alone;
  return sums;
}

// (cosh e - sinh(e)/e) / (2 e^2) for e^2 = d, an entire function of d.
double critical_series(double d) {
  double power = 1.0;  // d^(n-1) / (2n+1)!
  double sum = 0.0;
  for (int n = 1; n <= critical_series_terms; ++n) {
    power /= (2.0 * n) * (2.0 * n + 1.0);
    sum += n * power;
    power *= d;
  }
  return sum;
}

}  // namespace

SpringDerivatives spring_derivatives(double stiffness, double damping, double duration,
                                     const SpringCoefficients& factors) noexcept {
  stiffness = std::min(stiffness, largest_stiffness);
  damping = std::min(damping, largest_damping);
  const double ks = std::min(stiffness * duration * duration, largest_stiffness);
  const double kd = std::min(damping * duration, largest_damping);
  const double half = 0.5 * kd;
  DoubleResponse h{};
  if (kd <= series_damping && ks <= series_stiffness) {
    h = from_time_series(ks, kd);
  } else {
    const TwoPart d = discriminant(0.5 * damping, stiffness);
    const double scaled = d.high * duration * duration;
    bool far_roots = false;
    double slow = 0.0, fast = 0.0, gap = 1.0;
    if (scaled > series_discriminant) {
      const TwoPart root = root_times(d, duration);
      fast = half + root.high;
      slow = ks / fast;
      gap = 2.0 * root.high;
      far_roots = fast > 1.5 * slow;
      const double slow_decay = std::exp(-slow) / gap / gap;
      const double fast_decay = std::exp(-fast) / gap / gap;
      h.value = slow_decay * (1.0 - 2.0 / gap) + fast_decay * (1.0 + 2.0 / gap);
      h.slope = slow_decay * ((1.0 - slow) + 2.0 * slow / gap) + fast_decay * ((1.0 - fast) - 2.0 * fast / gap);
      h.curvature = slow_decay * slow * ((slow - 2.0) - 2.0 * slow / gap) + fast_decay * fast * ((fast - 2.0) + 2.0 * fast / gap);
    } else {
      if (scaled >= -series_discriminant) {
        h.value = std::exp(-half) * critical_series(scaled);
      } else {
        const TwoPart phase = root_times({-d.high, -d.low}, duration);
        const auto [cosine, sine] = turn_of(phase);
        h.value = std::exp(-half) * (sine / phase.high - cosine) / phase.high / (2.0 * phase.high);
      }
      h.slope = 0.5 * factors.impulse - half * h.value;
      h.curvature = 0.5 * (factors.impulse + factors.impulse_slope) - half * h.slope;
    }
    if (far_roots) {
      h.integral_alone = (mean_of_ramp(slow) + mean_of_ramp(fast)) / gap / gap -
                         2.0 * (mean_of_exponential(slow) - mean_of_exponential(fast)) / gap / gap / gap;
      h.mean = (mean_of_arch(slow) + mean_of_arch(fast)) / gap / gap -
               2.0 * (mean_of_mean_of_exponential(slow) - mean_of_mean_of_exponential(fast)) / gap / gap / gap;
      h.integral = ks * h.integral_alone;
    } else {
      // The equation integrated once and twice; here ks is large enough to divide by.
      h.integral = factors.acceleration - h.slope - kd * h.value;
      h.integral_alone = h.integral / ks;
      h.mean = (factors.acceleration_slope - h.value - kd * h.integral_alone) / ks;
    }
  }
  const double stiff = ks * h.value;
  SpringDerivatives derivatives{};
  derivatives.stiffness.decay = -ks * (0.5 * factors.impulse + half * h.value);
  derivatives.stiffness.impulse = -stiff;
  derivatives.stiffness.impulse_slope = -ks * h.slope;
  derivatives.stiffness.restoring = ks * (factors.impulse - stiff);
  derivatives.stiffness.acceleration = -h.integral;
  derivatives.stiffness.acceleration_slope = -ks * h.mean;
  derivatives.damping.decay = kd * stiff;
  derivatives.damping.impulse = -kd * h.slope;
  derivatives.damping.impulse_slope = -kd * h.curvature;
  derivatives.damping.restoring = -kd * (ks * h.slope);
  derivatives.damping.acceleration = -kd * h.value;
  derivatives.damping.acceleration_slope = -kd * h.integral_alone;
  return derivatives;
}

}  // namespace followthrough
