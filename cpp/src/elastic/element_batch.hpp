// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// St. Venant-Kirchhoff with compression resistance without a singular value decomposition, for elements whose stretches are all
/// above the clamp; compiled once per instruction set. Several elements at a time, one a lane. Plain arrays only: see
/// cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

namespace followthrough {

constexpr int batch_lanes = 8, single_lanes = 16;

/// What so many elements are made of.
struct alignas(64) BatchConstants {
  using Real = double;
  static constexpr int lanes = batch_lanes;
  double gradients[9][batch_lanes];  ///< of corners 1, 2, 3, row by row: a row a corner
  double mu[batch_lanes], lambda[batch_lanes], compression_resistance[batch_lanes], volume[batch_lanes];
};

/// The same in single precision.
struct alignas(64) SingleBatchConstants {
  using Real = float;
  static constexpr int lanes = single_lanes;
  float gradients[9][single_lanes];
  float mu[single_lanes], lambda[single_lanes], compression_resistance[single_lanes], volume[single_lanes];
};

/// Where elements' corners are, and what comes of it.
struct alignas(64) ElementBatch {
  double edges[9][batch_lanes];      ///< in: corners 1, 2, 3 minus corner 0, row by row: a row an axis, a column a corner
  double blocks[6][9][batch_lanes];  ///< out: stiffness, row by row, of the corner pairs 11, 12, 13, 22, 23, 33, N/m
  double inside[batch_lanes];        ///< out: 1 where all stretches are above the clamp; the rest is only true there
};

/// Floats that an element's stiffness takes: ten blocks of nine, row by row, and six to spare.
constexpr int stiffness_floats = 96;
/// Corners between which the blocks are: the first is the block's row.
constexpr int stiffness_corners[10][2] = {{1, 1}, {1, 2}, {1, 3}, {2, 2}, {2, 3}, {3, 3}, {0, 1}, {0, 2}, {0, 3}, {0, 0}};

/// The stiffness of so many elements in single precision.
struct alignas(64) SingleStiffness {
  float blocks[11][9][single_lanes];  ///< the last one is to spare
  float inside[single_lanes];         ///< as in ElementBatch
};

/// Elements that follow each other, 64 at most.
struct ElementRun {
  const std::int32_t* corners;  ///< 4 an element
  int count;
};

// cluster_forces adds scale times the elements' forces at their corners, except of elements beyond the clamp: it returns their
// bits. `positions` and `forces` have four numbers a vertex, of which the last one is not used. Batches are those of the run's
// elements. Where `energy` is not null, it becomes that of the other elements. cluster_mass adds, at every corner, the element's
// mass times the sum of its four corners' values and once more the corner's own. run_stiffness takes single_lanes elements at most.
#define FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(isa)                                                                               \
  namespace isa {                                                                                                                \
  std::uint64_t cluster_forces(const BatchConstants* batches, const ElementRun& run, const double* positions, double scale,      \
                               double smallest_stretch, double* forces, double* energy) noexcept;                                \
  std::uint64_t cluster_forces(const SingleBatchConstants* batches, const ElementRun& run, const double* positions, float scale, \
                               float smallest_stretch, float* forces) noexcept;                                                  \
  void cluster_mass(const double* masses, const ElementRun& run, const double* values, double* products) noexcept;               \
  void cluster_mass(const float* masses, const ElementRun& run, const float* values, float* products) noexcept;                  \
  void batch_stiffness(const BatchConstants& constants, ElementBatch& batch, double smallest_stretch, bool convex) noexcept;     \
  void run_stiffness(const SingleBatchConstants& constants, const ElementRun& run, const double* positions, float scale,         \
                     float smallest_stretch, bool convex, SingleStiffness& stiffness) noexcept;                                  \
  }
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS

}  // namespace followthrough
