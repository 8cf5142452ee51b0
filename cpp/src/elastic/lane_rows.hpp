// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Inner loops of conjugate gradients on 3x3 blocks in single precision, compiled once per instruction set. Plain arrays only: see
/// cmake/InstructionSets.cmake.
///
/// Rows go in groups of 16, a lane each. Every row adds up its elements' blocks in the same order, and sums over rows stay apart
/// lane by lane, so that nothing depends on which thread or which instruction set did it.
#pragma once

#include <cstdint>

#include "aggregates.hpp"
#include "elastic/element_batch.hpp"

namespace followthrough {

inline constexpr std::int32_t row_lanes = 16;

/// Slots of a group are 16 blocks, one of each of its rows; the first one is the diagonal. Where a row has no more neighbours its
/// lane is the row itself with zeros.
struct LaneRows {
  std::int32_t padded;                ///< rows, a multiple of 16; those to spare are the identity
  const std::int32_t* slot_starts;    ///< (groups + 1,)
  const std::int32_t* columns;        ///< (slots, 16) four times the row: where its vector starts
  const float* masses;                ///< (slots, 16) times the identity
  const std::int32_t* share_starts;   ///< (32 slots + 1,) into share_blocks, two a lane: blocks as they are, blocks to transpose
  const std::int32_t* share_blocks;   ///< places of elements' blocks in the stiffness
  const std::int32_t* coarse_places;  ///< (slots, 16) where a block counts in the coarse sums; -1: nowhere
  float* blocks;                      ///< (slots, 9, 16) row by row
  float* inverse;                     ///< (groups, 6, 16) of the diagonal: xx yy zz xy xz yz
};

/// (3, padded) each, but direction, which other rows read: (padded, 4).
struct LaneVectors {
  float *residual, *preconditioned, *direction, *product, *solution;
  float* restricted;    ///< (aggregates, 3) out: sums of the residual; null where there is no coarse system
  const float* coarse;  ///< (aggregates, 3) what the coarse system adds to the preconditioned residual; null likewise
};

/// Sums over groups, lane by lane.
struct RowSums {
  float sums[2][row_lanes];
};

// store_stiffness puts elements one after the other, stiffness_floats each. assemble_lane_rows gives false where a diagonal block
// is not positive definite; it adds to the coarse sums where they are not null. start_lane_rows begins from no solution and no
// direction and, as advance_lane_rows, sums up residual times preconditioned (the coarse system's share left out) and residual
// times residual; multiply_lane_rows direction times product.
#define FOLLOWTHROUGH_DECLARE_LANE_KERNELS(isa)                                                                                    \
  namespace isa {                                                                                                                  \
  void store_stiffness(const SingleStiffness& lanes, int count, float* to) noexcept;                                               \
  bool assemble_lane_rows(const LaneRows& rows, const float* stiffness, float* coarse_sums, std::int32_t first,                    \
                          std::int32_t last) noexcept;                                                                             \
  void start_lane_rows(const LaneRows& rows, const LaneVectors& v, std::int32_t first, std::int32_t last, RowSums* sums) noexcept; \
  void multiply_lane_rows(const LaneRows& rows, const LaneVectors& v, std::int32_t first, std::int32_t last,                       \
                          RowSums* sums) noexcept;                                                                                 \
  void advance_lane_rows(const LaneRows& rows, const LaneVectors& v, float length, std::int32_t first, std::int32_t last,          \
                         RowSums* sums) noexcept;                                                                                  \
  void turn_lane_rows(const LaneRows& rows, const LaneVectors& v, float share, std::int32_t first, std::int32_t last) noexcept;    \
  }
FOLLOWTHROUGH_DECLARE_LANE_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_LANE_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_LANE_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_LANE_KERNELS

}  // namespace followthrough
