// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_derivatives.hpp"

#include <doctest/doctest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "followthrough/springs/spring_fit.hpp"

using namespace followthrough;

namespace {

struct Row {
  double stiffness, damping;
  SpringCoefficients by_stiffness, by_damping;
};

struct LossRow {
  double stiffness, damping, loss, by_stiffness, by_damping;
};

constexpr double duration = 1.0 / 24.0;

const Row rows[] = {
#include "reference_derivatives.inc"
};

const LossRow loss_rows[] = {
#include "reference_losses.inc"
};

std::vector<double> values(const SpringCoefficients& k) {
  return {k.decay, k.impulse, k.impulse_slope, k.restoring, k.acceleration, k.acceleration_slope};
}

std::vector<double> all(const SpringDerivatives& derivatives) {
  std::vector<double> both = values(derivatives.stiffness);
  for (const double value : values(derivatives.damping)) both.push_back(value);
  return both;
}

}  // namespace

TEST_CASE("derivatives of the factors agree with 600-digit arithmetic all over the plane of constants") {
  for (const Row& row : rows) {
    CAPTURE(row.stiffness);
    CAPTURE(row.damping);
    const SpringCoefficients factors = spring_coefficients(row.stiffness, row.damping, duration);
    const SpringDerivatives found = spring_derivatives(row.stiffness, row.damping, duration, factors);
    const double ks = row.stiffness * duration * duration, kd = row.damping * duration;
    // Beyond a turn a frame a derivative swings, and is right to a share of its envelope.
    const bool swings = ks > kd * kd / 4.0 && ks > 1.0;
    const double envelope = swings ? std::exp(-kd / 2.0) : 0.0, turn = std::sqrt(ks);
    const double sizes[] = {turn, 1.0, turn, ks, 1.0 / turn, 1.0 / ks, kd, kd / turn, kd, ks * kd / turn, kd / ks, kd / ks};
    const std::vector<double> now = all(found);
    const std::vector<double> by_stiffness = values(row.by_stiffness), by_damping = values(row.by_damping);
    for (std::size_t i = 0; i < 12; ++i) {
      CAPTURE(i);
      const double expected = i < 6 ? by_stiffness[i] : by_damping[i - 6];
      const double size = std::max(std::abs(expected), envelope * sizes[i]);
      CHECK(std::abs(now[i] - expected) <= 1e-10 * size + 1e-300);
    }
  }
}

TEST_CASE(
    "gradients through the whole recursion agree with differences in 600-digit arithmetic, all over the plane and on the critical "
    "line") {
  const double reference[] = {0, 0, 3, 11, 20, 18, 7, 7, -4, -20, -11, 2};
  const double lag[] = {0, -1, -2, -5, -3, 2, 6, 1, 4, 5, -7, -3};
  Values target = Values::Zero(12, 3), wanted = Values::Zero(12, 3);
  for (int axis = 0; axis < 3; ++axis) {  // every axis in its turn has the motion
    target.setZero();
    for (int frame = 0; frame < 12; ++frame) {
      target(frame, axis) = reference[frame] / 64.0;
      wanted(frame, axis) = (reference[frame] + lag[frame]) / 64.0;
    }
    const SpringTraining training[] = {{target, wanted, duration}};
    for (const LossRow& row : loss_rows) {
      CAPTURE(row.stiffness);
      CAPTURE(row.damping);
      const SpringLoss found = spring_loss(training, Vector::Constant(1, row.stiffness), Vector::Constant(1, row.damping));
      CHECK(std::abs(found.loss[0] - row.loss) <= 1e-10 * row.loss);
      CHECK(std::abs(found.by_stiffness[0] - row.by_stiffness) <= 1e-6 * std::abs(row.by_stiffness));
      CHECK(std::abs(found.by_damping[0] - row.by_damping) <= 1e-6 * std::abs(row.by_damping));
    }
    wanted.setZero();
  }
}

TEST_CASE("derivatives are continuous where the formulas change") {
  const auto difference = [](double ks, double kd, double other_ks, double other_kd) {
    const std::vector<double> a = all(spring_derivatives(ks, kd, 1.0, spring_coefficients(ks, kd, 1.0)));
    const std::vector<double> b = all(spring_derivatives(other_ks, other_kd, 1.0, spring_coefficients(other_ks, other_kd, 1.0)));
    double largest = 0.0;
    for (std::size_t i = 0; i < a.size(); ++i) largest = std::max(largest, std::abs(a[i] - b[i]));
    return largest;
  };
  for (double half = 0.1; half < 20.0; half *= 1.3) {
    for (const double offset : {-1.0, 0.0, 1.0}) {  // critical damping, and where its series begins and ends
      const double stiffness = half * half + offset;
      if (stiffness > 0.0) {
        CHECK(difference(std::nextafter(stiffness, 0.0), 2.0 * half, std::nextafter(stiffness, 1e9), 2.0 * half) < 1e-12);
      }
    }
  }
  for (double other = 0.0; other < 3.0; other += 0.05) {
    CHECK(difference(other, 2.0, other, std::nextafter(2.0, 3.0)) < 1e-12);
    CHECK(difference(2.0, other, std::nextafter(2.0, 3.0), other) < 1e-12);
  }
}

TEST_CASE("derivatives stay finite for constants beyond any use") {
  for (const double stiffness : {0.0, 5e-324, 1e-300, 1.0, 1e12, 1e200, 1.7e308}) {
    for (const double damping : {0.0, 5e-324, 1e-300, 1.0, 1e12, 1e200, 1.7e308}) {
      for (const double time : {1e-12, 1.0 / 24.0, 1.0, 1e6}) {
        CAPTURE(stiffness);
        CAPTURE(damping);
        CAPTURE(time);
        for (const double value :
             all(spring_derivatives(stiffness, damping, time, spring_coefficients(stiffness, damping, time)))) {
          CHECK(std::isfinite(value));
        }
      }
    }
  }
}
