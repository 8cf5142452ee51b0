// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/conjugate_gradients.hpp"

#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace followthrough {
namespace {

using Block = BlockMatrix::Block;
using Eigen::Vector3d;

bool positive_definite(const Block& block) {
  const double minor = block(0, 0) * block(1, 1) - block(0, 1) * block(1, 0);
  return block(0, 0) > 0 && minor > 0 && block.determinant() > 0;
}

}  // namespace

void BlockPreconditioner::compute(const BlockMatrix& matrix) {
  const auto& starts = matrix.starts();
  const auto& columns = matrix.columns();
  inverse_diagonal_.resize(static_cast<std::size_t>(matrix.row_count()));
  for (Eigen::Index row = 0; row < matrix.row_count(); ++row) {
    const Index diagonal = matrix.diagonal()[row];
    const Block& own = matrix.blocks()[diagonal];
    Block reduced = own;
    for (Index k = starts[row]; k < diagonal; ++k) {
      const Block& lower = matrix.blocks()[k];
      reduced -= lower * inverse_diagonal_[columns[k]] * lower.transpose();
    }
    // Half its own size at least: a smaller pivot would be noise that the incomplete factor has let through.
    const double floor = 0.1;
    if (!positive_definite(reduced - floor * own)) reduced = own;
    if (!positive_definite(reduced)) reduced = Block::Identity() * std::max(own.trace() / 3, 1e-300);
    inverse_diagonal_[row] = reduced.inverse();
  }
}

void BlockPreconditioner::apply(const BlockMatrix& matrix, const Vector& r, Vector& z) const {
  const auto& starts = matrix.starts();
  const auto& columns = matrix.columns();
  const auto& blocks = matrix.blocks();
  const Eigen::Index rows = matrix.row_count();
  for (Eigen::Index row = 0; row < rows; ++row) {
    Vector3d sum = r.segment<3>(3 * row);
    for (Index k = starts[row]; k < matrix.diagonal()[row]; ++k) sum -= blocks[k] * z.segment<3>(3 * Eigen::Index{columns[k]});
    z.segment<3>(3 * row) = inverse_diagonal_[row] * sum;
  }
  for (Eigen::Index row = rows - 1; row >= 0; --row) {
    Vector3d sum = Vector3d::Zero();
    for (Index k = matrix.diagonal()[row] + 1; k < starts[row + 1]; ++k) {
      sum += blocks[k] * z.segment<3>(3 * Eigen::Index{columns[k]});
    }
    z.segment<3>(3 * row) -= inverse_diagonal_[row] * sum;
  }
}

LinearReport solve(const BlockMatrix& matrix, const BlockPreconditioner& preconditioner, const Vector& b, double tolerance,
                   int most_iterations, Vector& x) {
  LinearReport report;
  x.setZero(b.size());
  Vector residual = b, z(b.size()), product(b.size());
  const double goal = tolerance * b.norm();
  preconditioner.apply(matrix, residual, z);
  Vector direction = z;
  double slope = residual.dot(z);
  while (report.iterations < most_iterations && residual.norm() > goal && slope > 0) {
    matrix.multiply(direction.data(), product.data());
    const double curvature = direction.dot(product);
    if (!(curvature > 0)) {
      report.negative_curvature = true;
      return report;
    }
    const double step = slope / curvature;
    x += step * direction;
    residual -= step * product;
    ++report.iterations;
    preconditioner.apply(matrix, residual, z);
    const double new_slope = residual.dot(z);
    direction = z + (new_slope / slope) * direction;
    slope = new_slope;
  }
  return report;
}

}  // namespace followthrough
