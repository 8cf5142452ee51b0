// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/signed_svd.hpp"

#include <cmath>
#include <limits>
#include <utility>

#include <Eigen/Geometry>

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double epsilon = std::numeric_limits<double>::epsilon();
// Jacobi converges quadratically: random matrices take 4 sweeps, the worst known ones 7.
constexpr int most_sweeps = 30;

// Turns columns i and j of both matrices so that those of `columns` are perpendicular; false where they already were.
bool make_perpendicular(Matrix3d& columns, Matrix3d& v, int i, int j) {
  const double ii = columns.col(i).squaredNorm(), jj = columns.col(j).squaredNorm();
  const double ij = columns.col(i).dot(columns.col(j));
  if (std::abs(ij) <= epsilon * std::sqrt(ii) * std::sqrt(jj)) return false;
  const double slope = (jj - ii) / (2 * ij);
  const double tangent = std::copysign(1.0, slope) / (std::abs(slope) + std::sqrt(1 + slope * slope));
  const double cosine = 1 / std::sqrt(1 + tangent * tangent), sine = cosine * tangent;
  for (Matrix3d* m : {&columns, &v}) {
    const Vector3d first = m->col(i);
    m->col(i) = cosine * first - sine * m->col(j);
    m->col(j) = sine * first + cosine * m->col(j);
  }
  return true;
}

void sort_descending(Matrix3d& columns, Matrix3d& v) {
  for (const auto& [i, j] : {std::pair(0, 1), std::pair(1, 2), std::pair(0, 1)}) {
    if (columns.col(i).squaredNorm() >= columns.col(j).squaredNorm()) continue;
    for (Matrix3d* m : {&columns, &v}) {  // a quarter turn, so that v stays a rotation
      const Vector3d first = m->col(i);
      m->col(i) = m->col(j);
      m->col(j) = -first;
    }
  }
}

// A unit vector perpendicular to the unit vector `axis`, as near to `wish` as possible.
Vector3d perpendicular(const Vector3d& axis, const Vector3d& wish) {
  const Vector3d flat = wish - axis.dot(wish) * axis;
  if (flat.squaredNorm() > 1e-4) return (flat - axis.dot(flat) * axis).normalized();
  return axis.unitOrthogonal();
}

}  // namespace

SignedSvd signed_svd(const Matrix3d& matrix) {
  SignedSvd svd{Matrix3d::Identity(), Vector3d::Zero(), Matrix3d::Identity()};
  const double scale = matrix.cwiseAbs().maxCoeff();
  if (scale == 0) return svd;
  Matrix3d columns = matrix / scale;
  for (int sweep = 0; sweep < most_sweeps; ++sweep) {
    bool turned = make_perpendicular(columns, svd.v, 0, 1);
    turned = make_perpendicular(columns, svd.v, 0, 2) || turned;
    turned = make_perpendicular(columns, svd.v, 1, 2) || turned;
    if (!turned) break;
  }
  sort_descending(columns, svd.v);
  svd.u.col(0) = columns.col(0).normalized();
  const Vector3d second = columns.col(1) - svd.u.col(0).dot(columns.col(1)) * svd.u.col(0);
  svd.u.col(1) = second.norm() > 8 * epsilon ? second.normalized() : perpendicular(svd.u.col(0), svd.v.col(1));
  svd.u.col(2) = svd.u.col(0).cross(svd.u.col(1));
  for (int k = 0; k < 3; ++k) svd.stretches[k] = scale * svd.u.col(k).dot(columns.col(k));
  return svd;
}

}  // namespace followthrough
