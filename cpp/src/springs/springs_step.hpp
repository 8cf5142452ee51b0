// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The springs' inner loop, compiled once per instruction set. Plain arrays only: see cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

/// One frame's arrays. Those of positions have three numbers a vertex, those of factors one (SpringCoefficients).
struct SpringsStep {
  double* positions;    ///< in: at the frame's start; out: at its end
  double* velocities;   ///< likewise, 1/s
  double* before;       ///< in: reference one frame before the start; out: the reference at the end
  const double* start;  ///< reference at the start
  const double* end;    ///< reference at the end
  const double* after;  ///< reference one frame after the end
  double start_slope;   ///< times (end - before): the target's slope at the start, a frame
  double end_slope;     ///< times (after - start): the target's slope at the end, a frame
  double duration;      ///< s
  const double* decay;
  const double* impulse;
  const double* impulse_slope;
  const double* restoring;
  const double* acceleration;
  const double* acceleration_slope;
};

#define FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(isa)                                             \
  namespace isa {                                                                              \
  void springs_step(const SpringsStep& frame, std::int64_t first, std::int64_t last) noexcept; \
  bool all_finite(const double* values, std::int64_t count) noexcept;                          \
  }
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS

}  // namespace followthrough
