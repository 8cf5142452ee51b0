// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The springs' inner loop, compiled once per instruction set. Plain arrays only: see cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

/// @name Factors of one frame (SpringCoefficients)
/// In groups of vertices, each group one row of numbers for every factor: one stream through memory, not six, which caches of eight
/// ways would mix up.
/// @{
inline constexpr int factor_group = 8;  ///< vertices
enum SpringsFactor {
  decay_factor,
  impulse_factor,
  impulse_slope_factor,
  restoring_factor,
  acceleration_factor,
  bend_factor,  ///< 3 acceleration - 6 acceleration_slope: what a bend of the target's path does to the position
  factor_count
};
/// @}

/// One frame's arrays. Those of positions have three numbers a vertex.
struct SpringsStep {
  double* positions;      ///< in: at the frame's start; out: at its end
  double* velocities;     ///< likewise, 1/s
  double* before;         ///< in: reference one frame before the start; out: the reference at the end
  const double* start;    ///< reference at the start
  const double* end;      ///< reference at the end
  const double* after;    ///< reference one frame after the end
  double start_slope;     ///< times (end - before): the target's slope at the start, a frame
  double end_slope;       ///< times (after - start): the target's slope at the end, a frame
  double duration;        ///< s
  const double* factors;  ///< SpringsFactor; the last group may be partly unused
};

#define FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(isa)                                             \
  namespace isa {                                                                              \
  /* first: a multiple of factor_group */                                                      \
  void springs_step(const SpringsStep& frame, std::int64_t first, std::int64_t last) noexcept; \
  /* false where one of the values is not finite, or their sum overflows */                    \
  bool finite_sum(const double* values, std::int64_t count) noexcept;                          \
  }
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_SPRINGS_KERNELS

}  // namespace followthrough
