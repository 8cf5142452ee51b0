// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Inner loops over rows of 3x3 blocks, compiled once per instruction set. Plain arrays only: see cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

/// Blocks are stored column by column, one after the other, with at least one number to spare after the last.
struct BlockRows {
  const std::int32_t* starts;   ///< (rows + 1,) into columns and blocks
  const std::int32_t* columns;  ///< ascending in every row
  const double* blocks;         ///< 9 a block
};

#define FOLLOWTHROUGH_DECLARE_BLOCK_KERNELS(isa)                                                                           \
  namespace isa {                                                                                                          \
  void multiply_rows(const BlockRows& matrix, const double* x, double* y, std::int32_t first, std::int32_t last) noexcept; \
  }
FOLLOWTHROUGH_DECLARE_BLOCK_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_BLOCK_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_BLOCK_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_BLOCK_KERNELS

}  // namespace followthrough
