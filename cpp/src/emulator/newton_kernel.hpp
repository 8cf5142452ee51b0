// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Inner loops of a Newton pass (newton_problem.hpp), compiled once per instruction set. Plain arrays only: see
/// cmake/InstructionSets.cmake. Lengths are in edges, times in frames, masses such that the mean density is 1.
///
/// Tets, and rows (free vertices), go in groups of 16. Tets leave their shares one after the other; each row then adds up those
/// around it, always in the same order, so that nothing depends on which thread did what.
#pragma once

#include <cstdint>

#include "emulator/patch_kernel.hpp"

namespace followthrough {

inline constexpr std::int32_t kNewtonGroup = 16;
/// Ten blocks of nine floats and six to spare. Blocks 0 to 3 are a corner's: its stiffness (xx yy zz xy xz yz) and its force.
/// Blocks 4 to 9 are the stiffness between the corners 01 02 03 12 13 23, row by row.
inline constexpr std::int32_t kTetShare = 96;
/// Nine floats volume F, and the volume.
inline constexpr std::int32_t kGradientShare = 16;

struct NewtonTets {
  const std::int32_t* corners;  ///< (groups, 4, 16) rows, ascending in every tet; those at the end are repeated with no volume
  const float* gradients;       ///< (groups, 9, 16) inverse of the rest edges: F = edges gradients
  const float* materials;       ///< (groups, 4, 16) volume, mu, lambda, compression resistance
  const double* positions;      ///< (rows, 3)
  float* shares;                ///< out: (tets, 96)
  float* gradient_shares;       ///< out: (tets, 16), or null
  void (*raise_stretches)(float* deformation_gradient) noexcept;  ///< of an F, row by row, that may have small ones
};

/// The rows' equations. Slots of a group are 16 neighbours, one of each of its rows (or the row itself with nothing to add).
struct NewtonRows {
  std::int32_t padded;                 ///< rows, a multiple of 16
  const std::int32_t* tet_starts;      ///< (padded + 1,) into tet_blocks
  const std::int32_t* tet_blocks;      ///< offset in shares of a corner's block
  const std::int32_t* slot_starts;     ///< (groups + 1,) free neighbours
  const std::int32_t* slot_columns;    ///< (slots, 16) rows
  const float* slot_masses;            ///< (slots, 16)
  const std::int32_t* share_starts;    ///< (16 slots + 1,) into share_blocks
  const std::int32_t* share_blocks;    ///< offset in shares of the blocks that a slot adds up
  const std::uint32_t* slot_turned;    ///< (slots,) a bit a lane: the blocks are those of the other way round
  const std::int32_t* border_starts;   ///< (groups + 1,) constrained neighbours
  const std::int32_t* border_columns;  ///< (border slots, 16) places in offsets
  const float* border_masses;          ///< (border slots, 16)
  const float* masses;                 ///< (padded,) on the diagonal
  const float* shares;                 ///< of the tets
  const float* gradient_shares;        ///< of the tets
  std::int32_t offset_stride;          ///< padded, and the constrained rows
  const float* offsets;                ///< (3, offset_stride) z - y
  float* blocks;                       ///< out: (slots, 9, 16)
  float* diagonal;                     ///< out: (groups, 6, 16) xx yy zz xy xz yz
  float* inverse;                      ///< out: (groups, 6, 16)
  // Vectors of the conjugate gradients, (3, padded).
  float* residual;
  float* preconditioned;
  float* direction;
  float* product;
  float* solution;
  // Frames.
  float* rotations;                                                           ///< out: (padded, 9)
  float* gradients;                                                           ///< out: (padded, 9)
  void (*nearest_rotation)(const float* gradient, float* rotation) noexcept;  ///< where Newton's iterations do not get there
};

/// Sums over a block of groups, lane by lane.
struct LaneSums {
  float sums[2][kNewtonGroup];
};

/// Columns of a row of edge and of centre inputs, padded: 3 c + 8 and 3 c + 17 for up to 7 channels.
inline constexpr std::int32_t kNewtonEdgeStride = 32;
inline constexpr std::int32_t kNewtonCentreStride = 48;

/// What the edges and centres are told comes from here (newton_patches.hpp says what it is).
struct NewtonPatchFrame {
  std::int32_t free_count;
  std::int32_t channel_count;
  const std::int32_t* channel_columns;  ///< (channel_count,) where a channel starts in a record
  std::int32_t record_size;
  std::int32_t tail_column;        ///< where a record's last five start: z, 0.5 d, 1 where constrained
  const float* records;            ///< (rows, record_size)
  const std::int32_t* starts;      ///< (free + 1,) into neighbours
  const std::int32_t* neighbours;  ///< (edges,) rows
  std::int32_t edge_stride;        ///< edges, with room for a group beyond them
  const float* rest_edges;         ///< (3, edge_stride)
  const float* rotations;          ///< (padded, 9)
  const float* gradients;          ///< (padded, 9)
  const float* diagonal;           ///< (groups, 6, 16)
  const float* size;               ///< (padded,) sigma
  const float* inverse_size;       ///< (padded,) 1 / sigma
  const float* own;                ///< (padded, 5) what a centre is told of sigma, d, s, m and its degree
  float* steps;                    ///< out: (free, 3)
};

/// A pass's network. Rows that go into `instances` are the sums over the edges, then the centre's inputs.
struct NewtonNetwork {
  DenseKernel edge_first;  ///< without a bias: it adds to the centre's share
  DenseKernel centre;
  const DenseKernel* edges;
  const DenseKernel* instances;
  std::int32_t edge_count, instance_count;
  DenseKernel out;
  float skip;
  std::int32_t joined_width;
  std::int32_t widest;  ///< of the layers
};

#define FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(isa)                                                                         \
  namespace isa {                                                                                                         \
  void tet_shares(const NewtonTets& tets, std::int32_t first_group, std::int32_t last_group) noexcept;                    \
  void assemble_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept; \
  void row_frames(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group) noexcept;                    \
  void multiply_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept; \
  void advance_rows(const NewtonRows& rows, float length, std::int32_t first_group, std::int32_t last_group,              \
                    LaneSums* sums) noexcept;                                                                             \
  void turn_rows(const NewtonRows& rows, float share, std::int32_t first_group, std::int32_t last_group) noexcept;        \
  /* Rows of the edges of the centres [first, last), with room for 16 more behind them; of one group of centres. */       \
  void edge_inputs(const NewtonPatchFrame& frame, std::int32_t first, std::int32_t last, float* out,                      \
                   std::int32_t stride) noexcept;                                                                         \
  void centre_inputs(const NewtonPatchFrame& frame, std::int32_t group, float* out, std::int32_t stride) noexcept;        \
  void predict_steps(const NewtonPatchFrame& frame, const NewtonNetwork& network, std::int32_t first_group,               \
                     std::int32_t last_group, float* scratch) noexcept;                                                   \
  }
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS

}  // namespace followthrough
