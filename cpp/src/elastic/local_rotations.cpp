// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/local_rotations.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Dense>

#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int most_iterations = 8;
// Change below which the rotation counts as found: values are turned to start from, no more.
constexpr double small_change = 1e-6;
// Share of the cube of its size below which a map's determinant counts as none.
constexpr double smallest_determinant = 1e-6;
constexpr double vertex_nanoseconds = 300;

Matrix3d cofactors(const Matrix3d& m) {
  Matrix3d result;
  result.col(0) = m.col(1).cross(m.col(2));
  result.col(1) = m.col(2).cross(m.col(0));
  result.col(2) = m.col(0).cross(m.col(1));
  return result;
}

// Higham's Newton iteration, scaled [N. Higham, Computing the polar decomposition, 1986]: X becomes the mean of itself and its
// inverse transpose.
Matrix3d nearest_rotation(const Matrix3d& map) {
  Matrix3d x = map;
  const double size = x.norm();
  if (!(x.determinant() > smallest_determinant * size * size * size)) return Matrix3d::Identity();
  for (int iteration = 0; iteration < most_iterations; ++iteration) {
    const Matrix3d turned = cofactors(x);
    const Matrix3d inverse = turned / x.col(0).dot(turned.col(0));
    const double scale = std::sqrt(inverse.norm() / x.norm());
    const Matrix3d next = 0.5 * (scale * x + inverse / scale);
    const double change = (next - x).squaredNorm();
    x = next;
    if (change < small_change * small_change) break;
  }
  return x;
}

}  // namespace

LocalRotations::LocalRotations(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count,
                               std::vector<Index> vertices)
    : vertices_(std::move(vertices)) {
  std::vector<std::vector<Index>> neighbours(static_cast<std::size_t>(vertex_count));
  for (const std::array<Index, 4>& tet : corners) {
    for (const Index a : tet) {
      for (const Index b : tet) {
        if (a != b) neighbours[a].push_back(b);
      }
    }
  }
  starts_.push_back(0);
  for (const Index v : vertices_) {
    std::vector<Index>& all = neighbours[v];
    std::sort(all.begin(), all.end());
    all.erase(std::unique(all.begin(), all.end()), all.end());
    neighbours_.insert(neighbours_.end(), all.begin(), all.end());
    starts_.push_back(static_cast<Index>(neighbours_.size()));
  }
}

void LocalRotations::turn(ConstPositions from, ConstPositions to, Positions& values) const {
  const auto count = static_cast<std::ptrdiff_t>(vertices_.size());
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(count, vertex_nanoseconds))
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    const Index v = vertices_[k];
    Matrix3d map = Matrix3d::Zero();
    for (Index n = starts_[k]; n < starts_[k + 1]; ++n) {
      const Vector3d before = (from.row(neighbours_[n]) - from.row(v)).transpose();
      map += (to.row(neighbours_[n]) - to.row(v)).transpose() * before.transpose();
    }
    values.row(v) = (nearest_rotation(map) * values.row(v).transpose()).transpose().eval();
  }
}

}  // namespace followthrough
