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

/// The diagonal blocks: block Jacobi. An incomplete factor without fill-in breaks down on nearly incompressible flesh, and a
/// symmetric Gauss-Seidel sweep halves the iterations, each of which then takes more than twice as long.
class BlockDiagonal final : public Preconditioner {
 public:
  /// @return false where a block is not positive definite, and neither is the matrix; blocks like that count as their trace then
  bool compute(const BlockMatrix& matrix);
  void apply(const Vector& r, Vector& z) const override;

 private:
  std::vector<BlockMatrix::Block> inverse_;
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
