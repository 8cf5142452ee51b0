// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/conjugate_gradients.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Block = BlockMatrix::Block;

// What a row takes on one core.
constexpr double apply_nanoseconds = 5;

bool positive_definite(const Block& block) {
  const double minor = block(0, 0) * block(1, 1) - block(0, 1) * block(1, 0);
  return block(0, 0) > 0 && minor > 0 && block.determinant() > 0;
}

}  // namespace

bool BlockDiagonal::compute(const BlockMatrix& matrix) {
  inverse_.resize(static_cast<std::size_t>(matrix.row_count()));
  bool definite = true;
  for (std::size_t row = 0; row < inverse_.size(); ++row) {
    Block own = matrix.blocks()[matrix.diagonal()[row]];
    if (!positive_definite(own)) {
      definite = false;
      own = Block::Identity() * std::max(std::abs(own.trace()), 1e-12);
    }
    const Block inverse = own.inverse();
    inverse_[row] = 0.5 * (inverse + inverse.transpose());
  }
  return definite;
}

void BlockDiagonal::apply(const Vector& r, Vector& z) const {
  const auto rows = static_cast<Eigen::Index>(inverse_.size());
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(rows, apply_nanoseconds))
  for (Eigen::Index row = 0; row < rows; ++row) {
    z.segment<3>(3 * row).noalias() = inverse_[row] * r.segment<3>(3 * row);
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
