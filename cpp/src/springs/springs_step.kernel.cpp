// SPDX-License-Identifier: GPL-3.0-or-later
#include "springs/springs_step.hpp"

#if defined(_MSC_VER) || defined(__GNUC__)
#define FOLLOWTHROUGH_RESTRICT __restrict
#else
#define FOLLOWTHROUGH_RESTRICT
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {

void springs_step(const SpringsStep& frame, std::int64_t first, std::int64_t last) noexcept {
  double* FOLLOWTHROUGH_RESTRICT positions = frame.positions;
  double* FOLLOWTHROUGH_RESTRICT velocities = frame.velocities;
  double* FOLLOWTHROUGH_RESTRICT before = frame.before;
  const double* FOLLOWTHROUGH_RESTRICT start = frame.start;
  const double* FOLLOWTHROUGH_RESTRICT end = frame.end;
  const double* FOLLOWTHROUGH_RESTRICT after = frame.after;
  const double* FOLLOWTHROUGH_RESTRICT decay = frame.decay;
  const double* FOLLOWTHROUGH_RESTRICT impulse = frame.impulse;
  const double* FOLLOWTHROUGH_RESTRICT impulse_slope = frame.impulse_slope;
  const double* FOLLOWTHROUGH_RESTRICT restoring = frame.restoring;
  const double* FOLLOWTHROUGH_RESTRICT acceleration = frame.acceleration;
  const double* FOLLOWTHROUGH_RESTRICT acceleration_slope = frame.acceleration_slope;
  const double start_slope = frame.start_slope;
  const double end_slope = frame.end_slope;
  const double duration = frame.duration;
  const double rate = 1.0 / duration;
  for (std::int64_t v = first; v < last; ++v) {
    for (int c = 0; c < 3; ++c) {
      const std::int64_t i = 3 * v + c;
      const double reference = end[i];
      const double step = reference - start[i];
      const double slope0 = start_slope * (reference - before[i]);
      const double slope1 = end_slope * (after[i] - start[i]);
      // The cubic's acceleration over the frame is constant + linear * s ([ZS] eqs. 2 to 4), a frame squared.
      const double bend = slope0 + slope1 - (step + step);
      const double linear = 6.0 * bend;
      const double constant = (slope1 - slope0) - 3.0 * bend;
      const double lag = positions[i] - start[i];
      const double lag_rate = velocities[i] * duration - slope0;
      before[i] = reference;
      positions[i] =
          reference + ((decay[v] * lag + impulse[v] * lag_rate) - (acceleration[v] * constant + acceleration_slope[v] * linear));
      velocities[i] =
          rate *
          (slope1 + ((impulse_slope[v] * lag_rate - restoring[v] * lag) - (impulse[v] * constant + acceleration[v] * linear)));
    }
  }
}

bool all_finite(const double* values, std::int64_t count) noexcept {
  // Zero times a number is zero, times infinity or NaN is NaN, which no further addition removes.
  constexpr int lanes = 32;
  double sums[lanes] = {};
  std::int64_t i = 0;
  for (; i + lanes <= count; i += lanes) {
    for (int lane = 0; lane < lanes; ++lane) {
      sums[lane] += values[i + lane] * 0.0;
    }
  }
  double sum = 0.0;
  for (; i < count; ++i) {
    sum += values[i] * 0.0;
  }
  for (int lane = 0; lane < lanes; ++lane) {
    sum += sums[lane];
  }
  return sum == 0.0;
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
