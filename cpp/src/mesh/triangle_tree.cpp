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
  struct Sum {
    Eigen::Vector3d weighted, area;
    double total;
  };
  std::vector<Sum> sums(nodes.size());
  dipoles_.resize(nodes.size());
  for (std::size_t n = nodes.size(); n-- > 0;) {  // children before their parents
    const BoxTreeNode& node = nodes[n];
    Sum& sum = sums[n];
    if (node.right >= 0) {
      const Sum &left = sums[n + 1], &right = sums[static_cast<std::size_t>(node.right)];
      sum = {left.weighted + right.weighted, left.area + right.area, left.total + right.total};
    } else {
      sum = {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), 0};
      const auto begin = tree_.items().begin() + node.first;
      for (auto item = begin; item != begin + node.count; ++item) {
        const Eigen::Vector3d a = corner(*item, 0), b = corner(*item, 1), c = corner(*item, 2);
        const Eigen::Vector3d own = 0.5 * (b - a).cross(c - a);
        const double size = own.norm();
        sum.area += own;
        sum.weighted += size / 3 * (a + b + c);
        sum.total += size;
      }
    }
    const Eigen::Vector3d centre = sum.total > 0 ? Eigen::Vector3d(sum.weighted / sum.total) : Eigen::Vector3d(node.box.center());
    const Eigen::Vector3d reach = (node.box.max() - centre).cwiseMax(centre - node.box.min());
    dipoles_[n] = {centre, sum.area, reach.norm(), node.right};
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
  if (dipoles_.empty()) return 0;
  double far = 0, near = 0;  // sums times 4 pi, and as they are
  std::array<Index, 128> stack;
  int top = 0;
  stack[0] = 0;
  while (top >= 0) {
    const auto index = static_cast<std::size_t>(stack[static_cast<std::size_t>(top--)]);
    const Dipole& dipole = dipoles_[index];
    const Eigen::Vector3d away = dipole.centre - point;
    const double squared_distance = away.squaredNorm(), bound = opening * dipole.radius;
    if (squared_distance > bound * bound) {
      far += dipole.area.dot(away) / (squared_distance * std::sqrt(squared_distance));
    } else if (dipole.right < 0) {
      const BoxTreeNode& node = tree_.nodes()[index];
      for (Index k = node.first; k < node.first + node.count; ++k) {
        const Index t = tree_.items()[static_cast<std::size_t>(k)];
        near += solid_angle_share(corner(t, 0) - point, corner(t, 1) - point, corner(t, 2) - point);
      }
    } else {
      stack[static_cast<std::size_t>(++top)] = dipole.right;
      stack[static_cast<std::size_t>(++top)] = static_cast<Index>(index + 1);
    }
  }
  return far / (4 * std::numbers::pi) + near;
}

double TriangleTree::winding_number_near(const Eigen::Vector3d& point, double threshold) const {
  // Errors are a small part of these margins: they fall with the square of the opening.
  struct Try {
    double opening, margin;
  };
  for (const Try& attempt : {Try{1.5, 0.3}, Try{3, 0.1}}) {
    const double coarse = winding_number(point, attempt.opening);
    if (std::abs(std::abs(coarse) - threshold) > attempt.margin) return coarse;
  }
  return winding_number(point, 12);
}

}  // namespace followthrough
