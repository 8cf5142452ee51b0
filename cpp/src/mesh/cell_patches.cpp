// SPDX-License-Identifier: GPL-3.0-or-later
#include "cell_patches.hpp"

#include <algorithm>
#include <cmath>
#include <tuple>

#include "disjoint_sets.hpp"

namespace followthrough {
namespace {

constexpr double kBelow = 1e-6;  // how far under the surface one looks from, in cell edges

}  // namespace

CellPatches patches_in_cell(const PreparedSurface& surface, const Voxels& voxels, Index cell) {
  CellPatches result;
  const auto begin = static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell)]);
  const auto end = static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell) + 1]);
  const Eigen::Vector3d centre = voxels.grid.cell(cell).cast<double>() + Eigen::Vector3d::Constant(0.5);
  DisjointSets sets(end - begin);
  struct Edge {
    Index low, high, triangle;
  };
  std::vector<Edge> edges;  // low == high: a vertex
  edges.reserve(6 * (end - begin));
  for (std::size_t k = begin; k < end; ++k) {
    const Index t = voxels.touch_triangles[k];
    for (int corner = 0; corner < 3; ++corner) {
      const Index a = surface.triangles(t, corner), b = surface.triangles(t, (corner + 1) % 3);
      edges.push_back({a, a, static_cast<Index>(k - begin)});
      edges.push_back({std::min(a, b), std::max(a, b), static_cast<Index>(k - begin)});
    }
  }
  std::sort(edges.begin(), edges.end(),
            [](const Edge& a, const Edge& b) { return std::tie(a.low, a.high, a.triangle) < std::tie(b.low, b.high, b.triangle); });
  for (std::size_t first = 0, last = 0; first < edges.size(); first = last) {
    while (last < edges.size() && edges[last].low == edges[first].low && edges[last].high == edges[first].high) ++last;
    const Eigen::Vector3d a = voxels.grid.to_grid(surface.vertices.row(edges[first].low));
    const Eigen::Vector3d b = voxels.grid.to_grid(surface.vertices.row(edges[first].high));
    const double reach = ((a - centre).cwiseAbs()).cwiseMax((b - centre).cwiseAbs()).maxCoeff();
    const bool within = reach < 0.5 - 2 * kTouchDepth;
    if (within && last - first < 2) continue;
    if (!within && !triangle_meets_cube({a, b, b}, centre, 0.5 + 2 * kTouchDepth)) continue;
    if (!within)
      result.borders.push_back({edges[first].low, edges[first].high, begin + static_cast<std::size_t>(edges[first].triangle)});
    for (std::size_t k = first; k < last; ++k) sets.join(edges[first].triangle, edges[k].triangle);
  }
  result.labels = sets.labels(result.count);
  return result;
}

CellView::CellView(const PreparedSurface& surface, const Voxels& voxels, Index cell)
    : centre_(voxels.grid.cell(cell).cast<double>() + Eigen::Vector3d::Constant(0.5)) {
  const auto begin = static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell)]);
  const auto end = static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell) + 1]);
  triangles_.reserve(end - begin);
  for (std::size_t k = begin; k < end; ++k) {
    auto& corners = triangles_.emplace_back();
    for (std::size_t corner = 0; corner < 3; ++corner) {
      corners[corner] = voxels.grid.to_grid(
          surface.vertices.row(surface.triangles(voxels.touch_triangles[k], static_cast<Eigen::Index>(corner))));
    }
  }
}

bool CellView::point_below(std::size_t triangle, Eigen::Vector3d& point) const {
  // The part of the triangle in the cell, cut plane by plane; its corners' mean lies in it, as it is convex.
  std::vector<Eigen::Vector3d> polygon(triangles_[triangle].begin(), triangles_[triangle].end()), cut;
  const Eigen::Vector3d normal = (polygon[1] - polygon[0]).cross(polygon[2] - polygon[0]);
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-1.0, 1.0}) {
      cut.clear();
      for (std::size_t k = 0; k < polygon.size(); ++k) {
        const Eigen::Vector3d& a = polygon[k];
        const Eigen::Vector3d& b = polygon[(k + 1) % polygon.size()];
        const double height_a = 0.5 - side * (a[axis] - centre_[axis]), height_b = 0.5 - side * (b[axis] - centre_[axis]);
        if (height_a >= 0) cut.push_back(a);
        if ((height_a < 0) != (height_b < 0)) cut.push_back(a + height_a / (height_a - height_b) * (b - a));
      }
      polygon.swap(cut);
      if (polygon.empty()) return false;
    }
  }
  const double area = normal.norm();
  if (!(area > 1e-12)) return false;
  point.setZero();
  for (const auto& corner : polygon) point += corner / static_cast<double>(polygon.size());
  point -= kBelow / area * normal;
  return true;
}

Eigen::Vector3d CellView::normal(std::size_t triangle) const {
  const auto& x = triangles_[triangle];
  return (x[1] - x[0]).cross(x[2] - x[0]);
}

bool CellView::between(std::size_t triangle, const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  const auto& x = triangles_[triangle];
  const Eigen::Vector3d ab = x[1] - x[0], ac = x[2] - x[0], start = from - x[0];
  const Eigen::Vector3d across = ab.cross(ac);
  const double height_from = across.dot(start), height_to = across.dot(to - x[0]);
  if ((height_from > 0) == (height_to > 0) || height_from == height_to) return false;
  const Eigen::Vector3d hit = start + height_from / (height_from - height_to) * (to - from);
  const double area = across.squaredNorm();
  const double v = across.dot(hit.cross(ac)) / area, w = across.dot(ab.cross(hit)) / area;
  return v >= -1e-9 && w >= -1e-9 && v + w <= 1 + 1e-9;
}

bool CellView::sees(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    if (between(t, from, to)) return false;
  }
  return true;
}

bool CellView::sees_out_of_overlap(std::size_t start, const Eigen::Vector3d& from, const Eigen::Vector3d& to) const {
  int passed = 0;
  for (std::size_t t = 0; t < triangles_.size(); ++t) {
    if (!between(t, from, to)) continue;
    if (++passed > 1 || normal(t).dot(to - from) <= 0 || normal(t).dot(normal(start)) >= 0) return false;
  }
  return passed == 1;
}

}  // namespace followthrough
