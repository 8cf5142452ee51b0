// SPDX-License-Identifier: GPL-3.0-or-later
#include "triangle_tree.hpp"

#include <cmath>
#include <numbers>

namespace followthrough {
namespace {

std::vector<Box> triangle_boxes(ConstPositions vertices, ConstTriangles triangles) {
  std::vector<Box> boxes(static_cast<std::size_t>(triangles.rows()));
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    for (int k = 0; k < 3; ++k) boxes[static_cast<std::size_t>(t)].extend(Eigen::Vector3d(vertices.row(triangles(t, k))));
  }
  return boxes;
}

// Signed solid angle over 4 pi [van Oosterom and Strackee 1983].
double solid_angle_share(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  const double la = a.norm(), lb = b.norm(), lc = c.norm();
  const double numerator = a.dot(b.cross(c));
  const double denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
  if (numerator == 0) return 0;  // in the triangle's plane, or the triangle has no area: both sides cancel
  return std::atan2(numerator, denominator) / (2 * std::numbers::pi);
}

ClosestPoint on_segment(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b, int ka, int kb) {
  const Eigen::Vector3d along = b - a;
  const double length = along.squaredNorm();
  const double t = length > 0 ? std::clamp((p - a).dot(along) / length, 0.0, 1.0) : 0.0;
  ClosestPoint result;
  result.barycentric[ka] = 1 - t;
  result.barycentric[kb] += t;
  result.squared_distance = (p - a - t * along).squaredNorm();
  return result;
}

}  // namespace

ClosestPoint closest_on_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                 const Eigen::Vector3d& c) {
  const Eigen::Vector3d ab = b - a, ac = c - a, ap = p - a;
  const Eigen::Vector3d normal = ab.cross(ac);
  const double area = normal.squaredNorm();
  const double longest = std::max(ab.squaredNorm(), ac.squaredNorm());
  if (area > 1e-24 * longest * longest) {
    const double v = normal.dot(ap.cross(ac)) / area;
    const double w = normal.dot(ab.cross(ap)) / area;
    if (v >= 0 && w >= 0 && v + w <= 1) {
      ClosestPoint inside;
      inside.barycentric = Eigen::Vector3d(1 - v - w, v, w);
      const double height = normal.dot(ap);
      inside.squared_distance = height * height / area;
      return inside;
    }
  }
  ClosestPoint best = on_segment(p, a, b, 0, 1);
  for (const ClosestPoint& other : {on_segment(p, b, c, 1, 2), on_segment(p, a, c, 0, 2)}) {
    if (other.squared_distance < best.squared_distance) best = other;
  }
  return best;
}

TriangleTree::TriangleTree(ConstPositions vertices, ConstTriangles triangles)
    : vertices_(vertices), triangles_(triangles), tree_(triangle_boxes(vertices_, triangles_)) {
  const auto& nodes = tree_.nodes();
  dipoles_.resize(nodes.size());
  for (std::size_t n = 0; n < nodes.size(); ++n) {
    Eigen::Vector3d weighted = Eigen::Vector3d::Zero(), area = Eigen::Vector3d::Zero();
    double total = 0;
    const auto begin = tree_.items().begin() + nodes[n].first;
    for (auto item = begin; item != begin + nodes[n].count; ++item) {
      const Eigen::Vector3d a = corner(*item, 0), b = corner(*item, 1), c = corner(*item, 2);
      const Eigen::Vector3d own = 0.5 * (b - a).cross(c - a);
      const double size = own.norm();
      area += own;
      weighted += size / 3 * (a + b + c);
      total += size;
    }
    const Eigen::Vector3d centre = total > 0 ? Eigen::Vector3d(weighted / total) : Eigen::Vector3d(nodes[n].box.center());
    const Eigen::Vector3d reach = (nodes[n].box.max() - centre).cwiseMax(centre - nodes[n].box.min());
    dipoles_[n] = {centre, area, reach.norm()};
  }
}

ClosestPoint TriangleTree::closest(const Eigen::Vector3d& point) const {
  const Index best = tree_.nearest(
      point, [&](Index t) { return closest_on_triangle(point, corner(t, 0), corner(t, 1), corner(t, 2)).squared_distance; });
  ClosestPoint result;
  if (best >= 0) {
    result = closest_on_triangle(point, corner(best, 0), corner(best, 1), corner(best, 2));
    result.triangle = best;
  }
  return result;
}

double TriangleTree::winding_number(const Eigen::Vector3d& point, double opening) const {
  const auto& nodes = tree_.nodes();
  if (nodes.empty()) return 0;
  double sum = 0;
  std::array<Index, 128> stack;
  int top = 0;
  stack[0] = 0;
  while (top >= 0) {
    const auto index = static_cast<std::size_t>(stack[static_cast<std::size_t>(top--)]);
    const BoxTreeNode& node = nodes[index];
    const Dipole& dipole = dipoles_[index];
    const Eigen::Vector3d away = dipole.centre - point;
    const double distance = away.norm();
    if (distance > opening * dipole.radius) {
      sum += dipole.area.dot(away) / (4 * std::numbers::pi * distance * distance * distance);
    } else if (node.right < 0) {
      for (Index k = node.first; k < node.first + node.count; ++k) {
        const Index t = tree_.items()[static_cast<std::size_t>(k)];
        sum += solid_angle_share(corner(t, 0) - point, corner(t, 1) - point, corner(t, 2) - point);
      }
    } else {
      stack[static_cast<std::size_t>(++top)] = node.right;
      stack[static_cast<std::size_t>(++top)] = static_cast<Index>(index + 1);
    }
  }
  return sum;
}

double TriangleTree::winding_number_near(const Eigen::Vector3d& point, double threshold) const {
  const double coarse = winding_number(point, 3);
  return std::abs(std::abs(coarse) - threshold) > 0.1 ? coarse : winding_number(point, 12);
}

}  // namespace followthrough
