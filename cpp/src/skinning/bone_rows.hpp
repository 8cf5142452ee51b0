// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The inner loop of blending: one vertex's sum of table rows. Compiled once per instruction set, plain arrays only: see
/// cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

/// A table of numbers for each bone, and where one vertex hangs on it.
struct BoneRows {
  const double* table;          ///< (bones + 1, columns), row by row; the last row is for no bone
  std::int64_t bones;           ///< b
  const std::int32_t* indices;  ///< (places,) -1 for no bone
  const double* weights;        ///< (places,)
  std::int64_t places;
};

#define FOLLOWTHROUGH_DECLARE_BONE_KERNELS(isa)                                                                           \
  namespace isa {                                                                                                         \
  /* 12 columns, into `sum`; returns the total weight. `valid` becomes false where an index or weight cannot be used. */  \
  double sum_bone_matrices(const BoneRows& rows, double* sum, bool& valid) noexcept;                                      \
  /* 20 columns, the first four of them a quaternion: of the two of a rotation, the one on the side of the sum so far. */ \
  double sum_bone_quaternions(const BoneRows& rows, double* sum, bool& valid) noexcept;                                   \
  }
FOLLOWTHROUGH_DECLARE_BONE_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_BONE_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_BONE_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_BONE_KERNELS

}  // namespace followthrough
