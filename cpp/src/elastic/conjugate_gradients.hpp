// SPDX-License-Identifier: GPL-3.0-or-later
// Preconditioned conjugate gradients on block matrices; the same bits for any number of threads.
#pragma once

#include "elastic/block_matrix.hpp"

namespace followthrough {

class Preconditioner {
 public:
  virtual ~Preconditioner() = default;
  /// z = preconditioner^-1 r; z has r's size already.
  virtual void apply(const Vector& r, Vector& z) const = 0;
};

/// Incomplete Cholesky factor without fill-in, A ~ (L + D) D^-1 (L + D)^T with L the strictly lower part of A: only the diagonal
/// blocks are changed. L is kept in single precision (rounded alike on both sides, so that all stays symmetric), and within ranges
/// of rows that know nothing of each other, one a thread.
class BlockPreconditioner final : public Preconditioner {
 public:
  void compute(const BlockMatrix& matrix);
  void apply(const Vector& r, Vector& z) const override;

 private:
  void compute_range(const BlockMatrix& matrix, Index first, Index last);

  const BlockMatrix* pattern_ = nullptr;
  double scale_ = 1;
  std::vector<Index> lower_, upper_;
  std::vector<float> blocks_;
  std::vector<double> inverse_diagonal_;
};

struct LinearReport {
  int iterations = 0;
  bool converged = false;           ///< to the tolerance
  bool negative_curvature = false;  ///< the matrix is not positive definite; x is the last iterate before that showed
};

/// @brief Solves matrix * x = b from x = 0.
/// @param tolerance stops at |b - matrix x| <= tolerance |b|
LinearReport solve(const BlockMatrix& matrix, const Preconditioner& preconditioner, const Vector& b, double tolerance,
                   int most_iterations, Vector& x);

}  // namespace followthrough
