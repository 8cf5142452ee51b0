// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dense inner loops of a sparse Cholesky factorization in single precision, compiled once per instruction set. Plain arrays only:
/// see cmake/InstructionSets.cmake. Matrices are stored column by column, `stride` numbers apart; the stride is a multiple of
/// front_lanes, and rows beyond the last one are zero.
#pragma once

namespace followthrough {

constexpr int front_lanes = 16;

#define FOLLOWTHROUGH_DECLARE_FRONT_KERNELS(isa)                                                                             \
  namespace isa {                                                                                                            \
  /* Eliminates the first `pivots` columns of a symmetric matrix, given by its lower half: they become L with the inverse */ \
  /* of its diagonal on the diagonal, the rest what is left to eliminate. False where a pivot is not above `smallest`; */    \
  /* the matrix is then left half done. */                                                                                   \
  bool eliminate(float* matrix, int stride, int rows, int pivots, float smallest) noexcept;                                  \
  /* Solves L y = x in place for the first `pivots` numbers and takes L's other rows times y from the others. What the */    \
  /* panel has above its diagonal must be zero, here and below; x has `stride` numbers. */                                   \
  void solve_lower(const float* panel, int stride, int pivots, float* x) noexcept;                                           \
  /* Solves L^T y = x in place for the first `pivots` numbers; the others are known. */                                      \
  void solve_upper(const float* panel, int stride, int pivots, float* x) noexcept;                                           \
  }
FOLLOWTHROUGH_DECLARE_FRONT_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_FRONT_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_FRONT_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_FRONT_KERNELS

}  // namespace followthrough
