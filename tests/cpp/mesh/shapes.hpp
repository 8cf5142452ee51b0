// SPDX-License-Identifier: GPL-3.0-or-later
// Procedural surfaces for the tests and the benchmarks.
#pragma once

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "followthrough/types.hpp"

namespace shapes {

struct Shape {
  followthrough::Positions vertices;
  followthrough::Triangles triangles;
};

/// Unit cube from the origin, two triangles a side, faces looking outside.
inline Shape cube() {
  Shape shape;
  shape.vertices.resize(8, 3);
  for (int k = 0; k < 8; ++k) shape.vertices.row(k) << (k >> 2 & 1), (k >> 1 & 1), (k & 1);
  shape.triangles.resize(12, 3);
  shape.triangles << 0, 1, 3, 0, 3, 2, 4, 6, 7, 4, 7, 5, 0, 4, 5, 0, 5, 1, 2, 3, 7, 2, 7, 6, 0, 2, 6, 0, 6, 4, 1, 5, 7, 1, 7, 3;
  return shape;
}

/// A tube of rings closed at both poles; `point(ring in 0..1, angle)` gives its positions.
template <typename Point>
Shape tube(int rings, int sides, Point&& point) {
  using followthrough::Index;
  Shape shape;
  shape.vertices.resize(rings * sides + 2, 3);
  for (int r = 0; r < rings; ++r) {
    for (int s = 0; s < sides; ++s) {
      shape.vertices.row(2 + r * sides + s) = point((r + 1.0) / (rings + 1.0), 2 * std::numbers::pi * s / sides);
    }
  }
  shape.vertices.row(0) = point(0.0, 0.0);
  shape.vertices.row(1) = point(1.0, 0.0);
  std::vector<Index> corners;
  for (int s = 0; s < sides; ++s) {
    const int next = (s + 1) % sides;
    corners.insert(corners.end(), {0, 2 + s, 2 + next, 1, 2 + (rings - 1) * sides + next, 2 + (rings - 1) * sides + s});
    for (int r = 0; r + 1 < rings; ++r) {
      const int a = 2 + r * sides + s, b = 2 + r * sides + next, c = a + sides, d = b + sides;
      corners.insert(corners.end(), {a, c, d, a, d, b});
    }
  }
  shape.triangles = Eigen::Map<const followthrough::Triangles>(corners.data(), static_cast<Eigen::Index>(corners.size() / 3), 3);
  return shape;
}

inline Shape sphere(int rings, int sides, double radius = 1) {
  return tube(rings, sides, [&](double along, double angle) -> Eigen::RowVector3d {
    const double polar = std::numbers::pi * along;
    return radius * Eigen::RowVector3d(std::sin(polar) * std::cos(angle), std::sin(polar) * std::sin(angle), std::cos(polar));
  });
}

/// A rod of the given radius bent to a horseshoe: two straight legs of length 3, `gap` apart, hanging from an arc. Negative gaps
/// overlap.
inline Shape horseshoe(double radius, double gap, int rings = 120, int sides = 32) {
  const double bend = radius + gap / 2;  // radius of the arc of the middle line
  const double leg = 3, arc = std::numbers::pi * bend, total = 2 * leg + arc;
  return tube(rings, sides, [=](double along, double angle) -> Eigen::RowVector3d {
    const double ease = 0.5 - 0.5 * std::cos(std::numbers::pi * along);  // denser towards the tips
    const double at = total * ease, turn = std::clamp((at - leg) / arc, 0.0, 1.0) * std::numbers::pi;
    const Eigen::RowVector3d outward(-std::cos(turn), 0, std::sin(turn));
    Eigen::RowVector3d middle = bend * outward;
    if (at < leg) middle[2] -= leg - at;
    if (at > leg + arc) middle[2] -= at - leg - arc;
    const double tip = std::min({1.0, at / radius, (total - at) / radius});
    const double thickness = radius * std::sqrt(std::max(0.0, 1 - (1 - tip) * (1 - tip)));
    return middle - thickness * std::cos(angle) * outward + thickness * std::sin(angle) * Eigen::RowVector3d(0, 1, 0);
  });
}

/// Both shapes in one mesh.
inline Shape together(const Shape& a, const Shape& b) {
  Shape shape;
  shape.vertices.resize(a.vertices.rows() + b.vertices.rows(), 3);
  shape.vertices << a.vertices, b.vertices;
  shape.triangles.resize(a.triangles.rows() + b.triangles.rows(), 3);
  shape.triangles << a.triangles, (b.triangles.array() + static_cast<followthrough::Index>(a.vertices.rows())).matrix();
  return shape;
}

inline Shape moved(Shape shape, const Eigen::RowVector3d& by) {
  shape.vertices.rowwise() += by;
  return shape;
}

/// Every triangle with vertices of its own.
inline Shape unwelded(const Shape& shape) {
  Shape result;
  result.vertices.resize(3 * shape.triangles.rows(), 3);
  result.triangles.resize(shape.triangles.rows(), 3);
  for (Eigen::Index t = 0; t < shape.triangles.rows(); ++t) {
    for (int k = 0; k < 3; ++k) {
      result.vertices.row(3 * t + k) = shape.vertices.row(shape.triangles(t, k));
      result.triangles(t, k) = static_cast<followthrough::Index>(3 * t + k);
    }
  }
  return result;
}

inline Shape inside_out(Shape shape) {
  shape.triangles.col(1).swap(shape.triangles.col(2));
  return shape;
}

}  // namespace shapes
