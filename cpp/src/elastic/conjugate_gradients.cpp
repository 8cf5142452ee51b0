// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/conjugate_gradients.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "elastic/block_rows.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Block = BlockMatrix::Block;

// Rows that are factored together: whatever the number of threads.
constexpr Index range_size = 2048;
// Share of its own size that a diagonal block must keep: a smaller one is noise that the incomplete factor has let through.
constexpr double smallest_pivot = 0.1;
// What a row takes on one core.
constexpr double factor_nanoseconds = 400, solve_nanoseconds = 60;

decltype(&baseline::solve_rows) solve_rows_kernel() {
  switch (instruction_set()) {
#ifdef FOLLOWTHROUGH_HAS_avx512
    case InstructionSet::avx512:
      return avx512::solve_rows;
#endif
#ifdef FOLLOWTHROUGH_HAS_avx2
    case InstructionSet::avx2:
      return avx2::solve_rows;
#endif
    default:
      return baseline::solve_rows;
  }
}

bool positive_definite(const Block& block) {
  const double minor = block(0, 0) * block(1, 1) - block(0, 1) * block(1, 0);
  return block(0, 0) > 0 && minor > 0 && block.determinant() > 0;
}

Index range_count(const BlockMatrix& matrix) { return static_cast<Index>((matrix.row_count() + range_size - 1) / range_size); }

Index range_end(const BlockMatrix& matrix, Index range) {
  return std::min((range + 1) * range_size, static_cast<Index>(matrix.row_count()));
}

}  // namespace

void BlockPreconditioner::compute(const BlockMatrix& matrix) {
  const auto rows = static_cast<std::size_t>(matrix.row_count());
  pattern_ = &matrix;
  lower_.resize(rows);
  upper_.resize(rows);
  inverse_diagonal_.resize(9 * rows + 1);
  blocks_.resize(9 * matrix.blocks().size());
  double largest = 0;
  for (const Index k : matrix.diagonal()) largest = std::max(largest, matrix.blocks()[k].diagonal().cwiseAbs().maxCoeff());
  scale_ = largest > 0 ? 1 / largest : 1;  // single precision has a short range
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(matrix.row_count(), factor_nanoseconds))
  for (Index range = 0; range < range_count(matrix); ++range) {
    compute_range(matrix, range * range_size, range_end(matrix, range));
  }
}

void BlockPreconditioner::compute_range(const BlockMatrix& matrix, Index first, Index last) {
  const auto& starts = matrix.starts();
  const auto& columns = matrix.columns();
  for (Index row = first; row < last; ++row) {
    const auto begin = columns.begin() + starts[row], end = columns.begin() + starts[row + 1];
    lower_[row] = static_cast<Index>(std::lower_bound(begin, end, first) - columns.begin());
    upper_[row] = static_cast<Index>(std::lower_bound(begin, end, last) - columns.begin());
    const Index diagonal = matrix.diagonal()[row];
    for (Index k = lower_[row]; k < upper_[row]; ++k) {
      Eigen::Map<Eigen::Matrix3f>(blocks_.data() + 9 * std::size_t(k)) = (scale_ * matrix.blocks()[k]).cast<float>();
    }
    const Block own = scale_ * matrix.blocks()[diagonal];
    Block reduced = own;
    for (Index k = lower_[row]; k < diagonal; ++k) {
      const Block block = Eigen::Map<const Eigen::Matrix3f>(blocks_.data() + 9 * std::size_t(k)).cast<double>();
      const Eigen::Map<const Block> inverse(inverse_diagonal_.data() + 9 * std::size_t(columns[k]));
      reduced.noalias() -= (block * inverse).eval() * block.transpose();
    }
    if (!positive_definite(reduced - smallest_pivot * own)) reduced = own;
    if (!positive_definite(reduced)) reduced = Block::Identity() * std::max(std::abs(own.trace()), 1e-12);
    const Block inverse = reduced.inverse();
    Eigen::Map<Block>(inverse_diagonal_.data() + 9 * std::size_t(row)) = 0.5 * (inverse + inverse.transpose());
  }
}

void BlockPreconditioner::apply(const Vector& r, Vector& z) const {
  const auto kernel = solve_rows_kernel();
  const TriangularRows factor{lower_.data(),  pattern_->diagonal().data(), upper_.data(), pattern_->columns().data(),
                              blocks_.data(), inverse_diagonal_.data()};
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(pattern_->row_count(), solve_nanoseconds))
  for (Index range = 0; range < range_count(*pattern_); ++range) {
    kernel(factor, scale_, r.data(), z.data(), range * range_size, range_end(*pattern_, range));
  }
}

LinearReport solve(const BlockMatrix& matrix, const Preconditioner& preconditioner, const Vector& b, double tolerance,
                   int most_iterations, Vector& x) {
  LinearReport report;
  x.setZero(b.size());
  double size = b.norm();
  const double goal = tolerance * size;
  report.converged = !(size > 0);
  if (report.converged) return report;
  Vector residual = b, z(b.size()), product(b.size());
  preconditioner.apply(residual, z);
  Vector direction = z;
  double slope = residual.dot(z);
  while (report.iterations < most_iterations && size > goal) {
    matrix.multiply(direction.data(), product.data());
    const double curvature = direction.dot(product);
    if (!(curvature > 0 && slope > 0)) {
      report.negative_curvature = true;
      return report;
    }
    const double step = slope / curvature;
    x += step * direction;
    residual -= step * product;
    size = residual.norm();
    ++report.iterations;
    preconditioner.apply(residual, z);
    const double new_slope = residual.dot(z);
    direction = z + (new_slope / slope) * direction;
    slope = new_slope;
  }
  report.converged = size <= goal;
  return report;
}

}  // namespace followthrough
