// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_coefficients.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <random>

using namespace followthrough;

namespace {

struct Row {
  double stiffness, damping, decay, impulse, impulse_slope, restoring, acceleration, acceleration_slope;
};

constexpr double duration = 1.0 / 24.0;

const Row rows[] = {
#include "reference_coefficients.inc"
};

}  // namespace

TEST_CASE("spring factors agree with 120-digit arithmetic all over the plane of constants") {
  for (const Row& row : rows) {
    CAPTURE(row.stiffness);
    CAPTURE(row.damping);
    const SpringCoefficients k = spring_coefficients(row.stiffness, row.damping, duration);
    const double ks = row.stiffness * duration * duration, kd = row.damping * duration;
    const double turn = kd * kd / 4.0 < ks ? std::sqrt(ks - kd * kd / 4.0) : 0.0;
    // What a factor swings between: its own size where it decays, the envelope where it oscillates.
    const double swing = turn > 0.0 ? std::exp(-kd / 2.0) : 0.0;
    const double impulse_size = std::max(std::abs(row.impulse), swing / std::max(turn, 1.0));
    const double decay_size = std::max(std::abs(row.decay), std::max(swing, kd / 2.0 * impulse_size));
    const double slope_size = std::max(std::abs(row.impulse_slope), std::max(swing, std::min(kd, 1.0) * impulse_size));
    const double accuracy = 1e-12;
    CHECK(std::abs(k.impulse - row.impulse) <= accuracy * impulse_size);
    CHECK(std::abs(k.decay - row.decay) <= accuracy * decay_size);
    CHECK(std::abs(k.impulse_slope - row.impulse_slope) <= accuracy * slope_size);
    CHECK(std::abs(k.restoring - row.restoring) <= accuracy * ks * impulse_size);
    const double acceleration_size = std::max(std::abs(row.acceleration), turn > 1.0 ? 1.0 / ks : 0.0);
    CHECK(std::abs(k.acceleration - row.acceleration) <= accuracy * acceleration_size);
    CHECK(std::abs(k.acceleration_slope - row.acceleration_slope) <= accuracy * std::abs(row.acceleration_slope));
  }
}

TEST_CASE("spring factors are continuous where the formulas change") {
  const auto difference = [](const SpringCoefficients& a, const SpringCoefficients& b) {
    return std::max({std::abs(a.decay - b.decay), std::abs(a.impulse - b.impulse), std::abs(a.impulse_slope - b.impulse_slope),
                     std::abs(a.restoring - b.restoring), std::abs(a.acceleration - b.acceleration),
                     std::abs(a.acceleration_slope - b.acceleration_slope)});
  };
  for (double half = 0.1; half < 20.0; half *= 1.3) {
    const double critical = half * half;
    const SpringCoefficients at = spring_coefficients(critical, 2.0 * half, 1.0);
    CHECK(difference(at, spring_coefficients(std::nextafter(critical, 0.0), 2.0 * half, 1.0)) < 1e-13);
    CHECK(difference(at, spring_coefficients(std::nextafter(critical, 1e9), 2.0 * half, 1.0)) < 1e-13);
  }
  for (double other = 0.0; other < 3.0; other += 0.05) {  // where the series ends
    CHECK(difference(spring_coefficients(other, 2.0, 1.0), spring_coefficients(other, std::nextafter(2.0, 3.0), 1.0)) < 1e-13);
    CHECK(difference(spring_coefficients(2.0, other, 1.0), spring_coefficients(std::nextafter(2.0, 3.0), other, 1.0)) < 1e-13);
  }
}

TEST_CASE("two half frames make a whole one") {
  std::mt19937 random(7);
  std::uniform_real_distribution<double> exponent(-4.0, 4.0);
  for (int trial = 0; trial < 1000; ++trial) {
    const double stiffness = std::pow(10.0, exponent(random)), damping = std::pow(10.0, exponent(random));
    const SpringCoefficients half = spring_coefficients(stiffness, damping, 0.05),
                             whole = spring_coefficients(stiffness, damping, 0.1);
    // The factors are the entries of a matrix that takes (y, y' t) over the time t.
    CHECK(half.decay * half.decay - half.impulse * half.restoring == doctest::Approx(whole.decay).epsilon(1e-11).scale(1.0));
    CHECK(half.impulse * (half.decay + half.impulse_slope) == doctest::Approx(2.0 * whole.impulse).epsilon(1e-11).scale(1.0));
  }
}

TEST_CASE("spring factors stay finite and bounded for constants beyond any use") {
  for (const double stiffness : {0.0, 5e-324, 1e-300, 1.0, 1e12, 1e200, 1.7e308}) {
    for (const double damping : {0.0, 5e-324, 1e-300, 1.0, 1e12, 1e200, 1.7e308}) {
      for (const double time : {1e-12, 1.0 / 24.0, 1.0, 1e6}) {
        CAPTURE(stiffness);
        CAPTURE(damping);
        CAPTURE(time);
        const SpringCoefficients k = spring_coefficients(stiffness, damping, time);
        for (const double factor : {k.decay, k.impulse, k.impulse_slope, k.acceleration, k.acceleration_slope}) {
          CHECK(std::abs(factor) <= 1.0 + 1e-12);
        }
        CHECK(std::isfinite(k.restoring));
      }
    }
  }
}
