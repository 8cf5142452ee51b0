// SPDX-License-Identifier: GPL-3.0-or-later
// Procedural surfaces for the tests and the benchmarks.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
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

/// The skin of those blocks of a grid for which `filled(centre)` holds: closed, connected over shared edges, faces looking outside.
/// @param lines the grid's planes along each axis, ascending
template <typename Filled>
Shape blocks(const std::array<std::vector<double>, 3>& lines, Filled&& filled) {
  using followthrough::Index;
  const auto solid = [&](std::array<int, 3> cell) {
    Eigen::RowVector3d centre;
    for (int a = 0; a < 3; ++a) {
      if (cell[a] < 0 || cell[a] + 1 >= static_cast<int>(lines[a].size())) return false;
      centre[a] = 0.5 * (lines[a][cell[a]] + lines[a][cell[a] + 1]);
    }
    return static_cast<bool>(filled(centre));
  };
  std::map<std::array<int, 3>, Index> numbers;
  std::vector<std::array<Index, 3>> faces;
  const auto corner = [&](const std::array<int, 3>& at) {
    return numbers.try_emplace(at, static_cast<Index>(numbers.size())).first->second;
  };
  for (int x = 0; x + 1 < static_cast<int>(lines[0].size()); ++x) {
    for (int y = 0; y + 1 < static_cast<int>(lines[1].size()); ++y) {
      for (int z = 0; z + 1 < static_cast<int>(lines[2].size()); ++z) {
        const std::array<int, 3> cell = {x, y, z};
        if (!solid(cell)) continue;
        for (int axis = 0; axis < 3; ++axis) {
          for (const int side : {0, 1}) {
            std::array<int, 3> beside = cell;
            beside[axis] += side ? 1 : -1;
            if (solid(beside)) continue;
            const int u = (axis + 1) % 3, v = (axis + 2) % 3;
            std::array<Index, 4> quad{};
            for (int k = 0; k < 4; ++k) {
              std::array<int, 3> at = cell;
              at[axis] += side;
              at[u] += k == 1 || k == 2;
              at[v] += k == 2 || k == 3;
              quad[k] = corner(at);
            }
            if (!side) std::swap(quad[1], quad[3]);
            faces.push_back({quad[0], quad[1], quad[2]});
            faces.push_back({quad[0], quad[2], quad[3]});
          }
        }
      }
    }
  }
  Shape shape;
  shape.vertices.resize(static_cast<Eigen::Index>(numbers.size()), 3);
  for (const auto& [at, number] : numbers) {
    for (int a = 0; a < 3; ++a) shape.vertices(number, a) = lines[a][at[a]];
  }
  shape.triangles.resize(static_cast<Eigen::Index>(faces.size()), 3);
  for (std::size_t f = 0; f < faces.size(); ++f)
    shape.triangles.row(static_cast<Eigen::Index>(f)) << faces[f][0], faces[f][1], faces[f][2];
  return shape;
}

/// Numbers from `low` to `high` in steps of about `step`.
inline std::vector<double> steps(double low, double high, double step) {
  const int count = std::max(1, static_cast<int>(std::lround((high - low) / step)));
  std::vector<double> result;
  for (int k = 0; k <= count; ++k) result.push_back(low + (high - low) * k / count);
  return result;
}

/// A hand: a palm up to z = 1.5 and four fingers of width 0.8 above it up to z = 5, with gaps between them.
inline Shape hand(double gap) {
  std::vector<double> across;
  for (int finger = 0; finger < 4; ++finger) {
    for (const double x : steps(finger * (0.8 + gap), finger * (0.8 + gap) + 0.8, 0.2)) across.push_back(x);
  }
  return blocks({across, steps(0, 0.8, 0.2), steps(0, 5, 0.25)},
                [gap](const Eigen::RowVector3d& centre) { return centre[2] < 1.5 || std::fmod(centre[0], 0.8 + gap) < 0.8; });
}

/// A head of 4 x 4 x 4 with its mouth closed but for a slit: from the front (y = 0) to y = 2, from corner to corner of the mouth.
inline Shape head(double slit) {
  std::vector<double> up = steps(0, 2, 0.25);
  for (const double z : steps(2 + slit, 4, 0.25)) up.push_back(z);
  return blocks({steps(0, 4, 0.25), steps(0, 4, 0.25), up}, [slit](const Eigen::RowVector3d& centre) {
    const bool mouth = centre[2] > 2 && centre[2] < 2 + slit && centre[1] < 2 && centre[0] > 0.5 && centre[0] < 3.5;
    return !mouth;
  });
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
