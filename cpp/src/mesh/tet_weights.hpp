// SPDX-License-Identifier: GPL-3.0-or-later
// Barycentric weights of a point in one tet.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Dense>

namespace followthrough {

using TetCorners = std::array<Eigen::Vector3d, 4>;

/// Six times the tet's signed volume.
inline double tet_determinant(const TetCorners& x) { return (x[1] - x[0]).dot((x[2] - x[0]).cross(x[3] - x[0])); }

/// Whether a tet has a volume to speak of, so that weights in it mean something.
inline bool tet_is_solid(const TetCorners& x) {
  const double longest = std::max({(x[1] - x[0]).squaredNorm(), (x[2] - x[0]).squaredNorm(), (x[3] - x[0]).squaredNorm()});
  return std::abs(tet_determinant(x)) > 1e-12 * longest * std::sqrt(longest);
}

/// Weights of any point, also outside. They sum to one up to the rounding of that one addition.
inline Eigen::Vector4d tet_weights(const Eigen::Vector3d& point, const TetCorners& x) {
  const Eigen::Vector3d a = x[1] - x[0], b = x[2] - x[0], c = x[3] - x[0], d = point - x[0];
  const double determinant = a.dot(b.cross(c));
  const double w1 = d.dot(b.cross(c)) / determinant;
  const double w2 = a.dot(d.cross(c)) / determinant;
  const double w3 = a.dot(b.cross(d)) / determinant;
  return {1 - (w1 + w2 + w3), w1, w2, w3};
}

}  // namespace followthrough
