// SPDX-License-Identifier: GPL-3.0-or-later
// Cholesky factorization of a block matrix in single precision, by dense fronts: a preconditioner that leaves conjugate gradients
// a handful of iterations.
#pragma once

#include <vector>

#include "elastic/block_matrix.hpp"
#include "elastic/conjugate_gradients.hpp"

namespace followthrough {

class SparseCholesky final : public Preconditioner {
 public:
  /// Orders the rows and finds out where the factor has numbers.
  explicit SparseCholesky(const BlockMatrix& pattern);

  /// @param matrix of the pattern
  /// @return false where the matrix is not positive definite as far as single precision can tell; there is no factor then
  bool compute(const BlockMatrix& matrix);
  void apply(const Vector& r, Vector& z) const override;

  /// Numbers of the factor, zeros within its panels included.
  std::size_t size() const { return numbers_; }
  /// Multiplications of a factorization, roughly.
  double work() const { return work_; }

 private:
  // Columns that share a pattern.
  struct Front {
    Index first = 0, count = 0;   // block columns, in the new order
    std::vector<Index> rows;      // block rows below them, ascending
    std::vector<Index> children;  // fronts
    std::size_t factor = 0;       // where its panel starts
    int stride = 0;
    int size() const { return static_cast<int>(3 * (count + static_cast<Index>(rows.size()))); }
  };

  void add_matrix(const BlockMatrix& matrix, const Front& front, float* to);

  std::vector<Index> order_, place_;  // old row of every new one, and back
  std::vector<Front> fronts_;         // children before parents
  std::size_t numbers_ = 0, work_numbers_ = 0;
  std::vector<float> factor_;      // none before the first factorization: soft bodies do without
  std::size_t factor_offset_ = 0;  // to the first aligned number
  std::vector<double> scale_;      // of the old rows' numbers
  std::vector<Index> local_;       // row of the current front of every new block row
  std::vector<std::vector<float>> updates_;
  std::vector<float> work_space_;
  mutable std::vector<float> right_, local_right_;
  double work_ = 0;
};

}  // namespace followthrough
