// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// St. Venant-Kirchhoff with compression resistance without a singular value decomposition, for elements whose stretches are all
/// above the clamp; compiled once per instruction set. Several elements at a time, one a lane. Plain arrays only: see
/// cmake/InstructionSets.cmake.
#pragma once

namespace followthrough {

constexpr int batch_lanes = 8;

/// What so many elements are made of.
struct alignas(64) BatchConstants {
  double gradients[9][batch_lanes];  ///< of corners 1, 2, 3, row by row: a row a corner
  double mu[batch_lanes], lambda[batch_lanes], compression_resistance[batch_lanes], volume[batch_lanes];
};

/// Where their corners are, and what comes of it.
struct alignas(64) ElementBatch {
  double edges[9][batch_lanes];      ///< in: corners 1, 2, 3 minus corner 0, row by row: a row an axis, a column a corner
  double energy[batch_lanes];        ///< out: J
  double forces[9][batch_lanes];     ///< out: of corners 1, 2, 3 as edges, N; corner 0 has minus their sum
  double blocks[6][9][batch_lanes];  ///< out: stiffness, row by row, of the corner pairs 11, 12, 13, 22, 23, 33, N/m
  double inside[batch_lanes];        ///< out: 1 where all stretches are above the clamp; the rest is only true there
};

#define FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(isa)                                                                           \
  namespace isa {                                                                                                            \
  void batch_forces(const BatchConstants& constants, ElementBatch& batch, double smallest_stretch) noexcept;                 \
  void batch_stiffness(const BatchConstants& constants, ElementBatch& batch, double smallest_stretch, bool convex) noexcept; \
  }
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_ELEMENT_KERNELS

}  // namespace followthrough
