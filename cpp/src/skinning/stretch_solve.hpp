// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One vertex of inverse skinning.
#pragma once

#include <cmath>
#include <limits>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

namespace followthrough {

/// What `stretch_solve` takes, roughly, where nothing has to be clamped (see worthwhile_threads).
inline constexpr double stretch_solve_nanoseconds = 15;

/// @brief Solves J offset = displacement with the singular values of J raised to `minimum_stretch` where they are below.
/// @return the offset, not finite where the numbers overflow
inline Eigen::Vector3d stretch_solve(const Eigen::Matrix3d& jacobian, const Eigen::Vector3d& displacement, double minimum_stretch) {
  using Eigen::Matrix3d;
  using Eigen::Vector3d;
  // The smallest singular value is at least 2 |det| / |J|^2 (the other two's product is at most half their sum of squares), so
  // this is proof, with some room for rounding, that nothing has to be clamped.
  const Vector3d x = jacobian.col(0), y = jacobian.col(1), z = jacobian.col(2);
  const Vector3d across = y.cross(z);
  const double determinant = x.dot(across);
  if (2.0 * std::abs(determinant) > 1.0001 * minimum_stretch * jacobian.squaredNorm()) {
    return Vector3d(across.dot(displacement), z.cross(x).dot(displacement), x.cross(y).dot(displacement)) / determinant;
  }
  const Eigen::JacobiSVD<Matrix3d> svd(jacobian, Eigen::ComputeFullU | Eigen::ComputeFullV);
  if (svd.info() != Eigen::Success) return Vector3d::Constant(std::numeric_limits<double>::quiet_NaN());
  const Vector3d along = svd.matrixU().transpose() * displacement;
  return svd.matrixV() * along.cwiseQuotient(svd.singularValues().cwiseMax(minimum_stretch));
}

}  // namespace followthrough
