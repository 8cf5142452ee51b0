// SPDX-License-Identifier: GPL-3.0-or-later
// Preconditioned conjugate gradients on block matrices; the same bits for any number of threads.
#pragma once

#include "elastic/block_matrix.hpp"

namespace followthrough {

/// Incomplete Cholesky factor of a block matrix without fill-in, A ~ (L + D) D^-1 (D + L^T) with L the strictly lower part of A:
/// only the diagonal blocks are changed. Where that breaks down, those blocks fall back to A's own (symmetric Gauss-Seidel).
class BlockPreconditioner {
 public:
  void compute(const BlockMatrix& matrix);
  /// z = preconditioner^-1 r
  void apply(const BlockMatrix& matrix, const Vector& r, Vector& z) const;

 private:
  std::vector<BlockMatrix::Block> inverse_diagonal_;
};

struct LinearReport {
  int iterations = 0;
  bool negative_curvature = false;  ///< the matrix is not positive definite; x is the last iterate before that showed
};

/// @brief Solves matrix * x = b from x = 0.
/// @param tolerance stops at |b - matrix x| <= tolerance |b|
LinearReport solve(const BlockMatrix& matrix, const BlockPreconditioner& preconditioner, const Vector& b, double tolerance,
                   int most_iterations, Vector& x);

}  // namespace followthrough
