// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Rotations of neighbourhoods, 16 vertices side by side in single precision, compiled once per instruction set. Plain arrays only:
/// see cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

inline constexpr std::int32_t rotation_lanes = 16;

/// Vertices by where their vectors of four floats start. Where one has no more neighbours, it is its own.
struct RotationRows {
  const std::int32_t* own;          ///< (groups, 16)
  const std::int32_t* slot_starts;  ///< (groups + 1,)
  const std::int32_t* neighbours;   ///< (slots, 16)
};

// turn_rotation_rows turns values, (16 groups, 4), by the rotation that is nearest to the least squares fit of a linear map from
// one pose, (n, 4), to the other. Where the fit is flat or mirrored, values stay as they are.
#define FOLLOWTHROUGH_DECLARE_ROTATION_KERNELS(isa)                                                                        \
  namespace isa {                                                                                                          \
  void turn_rotation_rows(const RotationRows& rows, const float* from, const float* to, float* values, std::int32_t first, \
                          std::int32_t last) noexcept;                                                                     \
  }
FOLLOWTHROUGH_DECLARE_ROTATION_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_ROTATION_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_ROTATION_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_ROTATION_KERNELS

}  // namespace followthrough
