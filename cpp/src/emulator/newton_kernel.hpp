// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Inner loops of a Newton pass (newton_problem.hpp), compiled once per instruction set. Plain arrays only: see
/// cmake/InstructionSets.cmake. Lengths are in edges, times in frames, masses such that the mean density is 1.
///
/// Tets, and rows (free vertices), go in groups of 16, groups of rows in parts. A tet belongs to the part of its lowest row, whose
/// thread adds it to that part's own sums, one tet after the other; what it adds to rows of later parts is the part's halo, and
/// they take it over in the order of the parts. So nothing depends on which thread did what.
#pragma once

#include <cstdint>

#include "emulator/patch_kernel.hpp"

namespace followthrough {

inline constexpr std::int32_t kNewtonGroup = 16;
/// Blocks that a tet adds to the sums. Blocks 0 to 3 are a corner's: its stiffness (xx yy zz xy xz yz) and its force. Blocks 4 to 9
/// are the stiffness between the corners 01 02 03 12 13 23, row by row.
inline constexpr std::int32_t kTetBlocks = 10;
/// Floats of a block.
inline constexpr std::int32_t kBlock = 9;

struct NewtonTets {
  const std::int32_t* corners;  ///< (groups, 4, 16) rows, ascending in every tet; a part's last ones are repeated with no volume
  const float* gradients;       ///< (groups, 9, 16) inverse of the rest edges: F = edges gradients
  const float* materials;       ///< (groups, 4, 16) volume, mu, lambda, compression resistance
  const double* positions;      ///< (rows, 3), and one more to spare
  const std::int32_t* places;   ///< (groups, 10, 16) in the sums; where nobody asks for a block, a place that nobody reads
  float* sums;                  ///< what is added to, and seven floats to spare
  float* energies;              ///< out: (groups, 16)
  bool exact;                   ///< the tangent, which may be indefinite, not a convex one
  void (*raise_stretches)(float* deformation_gradient) noexcept;  ///< of an F, row by row, that may have small ones
};

/// The rows' equations, every component divided by the root of the matrix's diagonal there, so that nothing in the matrix is larger
/// than 1 and 16 bits a number will do where it is large. Slots of a group are 16 neighbours, one of each of its rows (or the row
/// itself with nothing to add).
struct NewtonRows {
  std::int32_t padded;                 ///< rows, a multiple of 16
  const std::int32_t* row_places;      ///< (padded,) in the sums, of the corners' blocks
  const std::int32_t* slot_starts;     ///< (groups + 1,) free neighbours
  const std::int32_t* slot_columns;    ///< (slots, 16) where their vectors start in offsets and direction
  const float* slot_masses;            ///< (slots, 16)
  const std::int32_t* slot_places;     ///< (slots, 16) in the sums, of the block between the row and its neighbour
  const float* slot_turned;            ///< (slots, 16) 1 where that is the one of the other way round, else 0
  const std::int32_t* border_starts;   ///< (groups + 1,) constrained neighbours
  const std::int32_t* border_columns;  ///< (border slots, 16) likewise
  const float* border_masses;          ///< (border slots, 16)
  const float* masses;                 ///< (padded,) on the diagonal
  const float* pins;                   ///< (padded,) stiffness of springs to the reference; null: none
  const float* ways;                   ///< (3, padded) from y to the reference, where there are pins
  const float* sums;                   ///< of the tets; nine zeros come first
  const float* offsets;                ///< z - y, four floats a row, those of constrained rows after the padding
  float* scales;                       ///< out: (padded, 4) one over the roots
  float* traces;                       ///< out: (padded,) of the diagonal blocks as they were
  float* blocks;                       ///< out: (slots, 9, 16)
  std::int16_t* rounded_blocks;        ///< or these, 1 being 32767
  float* diagonal;                     ///< out: (groups, 3, 16) xy xz yz
  float* inverse;                      ///< out: (groups, 6, 16) xx yy zz xy xz yz
  float* first;                        ///< out: (3, padded) the first preconditioned residual, in edges
  // Vectors of the conjugate gradients, (3, padded).
  float* residual;
  float* preconditioned;
  float* product;
  float* solution;
  float* direction;  ///< (padded, 4)
  // Of the coarse system (coarse_rows.hpp): its vectors have a row's roots where the aggregate moves.
  float* roots;              ///< out: (3, padded) of the matrix's diagonal
  float* restricted;         ///< out: (aggregates, 3) sums of roots times residual; null where there is no coarse system
  const float* corrections;  ///< (aggregates, 3) what it adds to the preconditioned residual, over the roots; null likewise
};

/// Sums over a part, lane by lane.
struct LaneSums {
  float sums[4][kNewtonGroup];
};

/// Floats of a record: vectors of a row, one after the other, whose means over its neighbours are wanted.
inline constexpr std::int32_t kNewtonRecord = 16;

/// What a guide is told of the rows (newton_patches.hpp).
struct GuideInputs {
  std::int32_t padded;
  std::int32_t vector_count;
  const float* const* vectors;   ///< (vector_count,) of (3, padded)
  const float* inverse_squares;  ///< (padded,) one over the sum of the vectors' squares
  std::int32_t scalar_count;
  const float* const* scalars;  ///< (scalar_count,) of (padded,)
  float* steps;                 ///< out: (3, padded)
};

/// A layer as PyTorch has it.
struct GuideLayer {
  const float* weight;  ///< (outputs, inputs)
  const float* bias;    ///< (outputs,)
  std::int32_t inputs, outputs;
};

/// A guide's perceptron; a tanh after every layer but the last.
struct GuideKernel {
  const GuideLayer* layers;
  std::int32_t layer_count;
  std::int32_t widest;  ///< of its inputs and outputs
};

#define FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(isa)                                                                           \
  namespace isa {                                                                                                           \
  void add_tets(const NewtonTets& tets, std::int32_t first_group, std::int32_t last_group) noexcept;                        \
  /* Adds the block at the second of each pair of places in `from` to that at the first in `to`. */                         \
  void add_blocks(const std::int32_t* places, std::int32_t pairs, const float* from, float* to) noexcept;                   \
  void assemble_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept;   \
  void assemble_blocks(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group) noexcept;                 \
  /* The residual's sums over the aggregates. */                                                                            \
  void restrict_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group) noexcept;                   \
  void multiply_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept;   \
  void advance_rows(const NewtonRows& rows, float length, std::int32_t first_group, std::int32_t last_group,                \
                    LaneSums* sums) noexcept;                                                                               \
  void turn_rows(const NewtonRows& rows, float share, std::int32_t first_group, std::int32_t last_group) noexcept;          \
  /* The solution, whose square is summed up, and what is left, in edges. */                                                \
  void unscale_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept;    \
  /* Means of the neighbours' records minus the row's own, (16, padded). */                                                 \
  void neighbour_means(const float* records, const std::int32_t* starts, const std::int32_t* neighbours, std::int32_t rows, \
                       std::int32_t padded, std::int32_t first_group, std::int32_t last_group, float* means) noexcept;      \
  /* Scratch: 2 kNewtonGroup widest floats. */                                                                              \
  void guide_rows(const GuideInputs& inputs, const GuideKernel& guide, std::int32_t first_group, std::int32_t last_group,   \
                  float* scratch) noexcept;                                                                                 \
  }
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_NEWTON_KERNELS

}  // namespace followthrough
