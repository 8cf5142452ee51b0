// SPDX-License-Identifier: GPL-3.0-or-later
#include "cell_patches.hpp"

#include <algorithm>
#include <cmath>

#include "disjoint_sets.hpp"

namespace followthrough {
namespace {

constexpr double kBelow = 1e-6;  // how far under the surface one looks from, in cell edges

}  // namespace

PatchFinder::PatchFinder(const PreparedSurface& surface, const Voxels& voxels)
    : surface_(surface), voxels_(voxels), seen_(static_cast<std::size_t>(surface.element_count)) {}

CellPatches PatchFinder::operator()(Index cell) {
  CellPatches result;
  const auto begin = static_cast<std::size_t>(voxels_.touch_offsets[static_cast<std::size_t>(cell)]);
  const auto end = static_cast<std::size_t>(voxels_.touch_offsets[static_cast<std::size_t>(cell) + 1]);
  const Eigen::Vector3d centre = voxels_.grid.cell(cell).cast<double>() + Eigen::Vector3d::Constant(0.5);
  DisjointSets sets(end - begin);
  const auto meet = [&](Index element, const Eigen::Vector3d& a, const Eigen::Vector3d& b, std::size_t touch) {
    const auto triangle = static_cast<Index>(touch - begin);
    Seen& seen = seen_[static_cast<std::size_t>(element)];
    if (seen.cell == cell) {
      if (seen.first >= 0) sets.join(seen.first, triangle);
      return;
    }
    seen = {cell, triangle};
    const double reach = ((a - centre).cwiseAbs()).cwiseMax((b - centre).cwiseAbs()).maxCoeff();
    if (reach < 0.5 - 2 * kTouchDepth) return;
    if (triangle_meets_cube({a, b, b}, centre, 0.5 + 2 * kTouchDepth)) {
      result.borders.push_back({element, touch});
    } else {
      seen.first = -1;
    }
  };
  for (std::size_t touch = begin; touch < end; ++touch) {
    const Index t = voxels_.touch_triangles[touch];
    const std::array<Eigen::Vector3d, 3> x = {voxels_.corner(surface_, t, 0), voxels_.corner(surface_, t, 1),
                                              voxels_.corner(surface_, t, 2)};
    for (std::size_t k = 0; k < 3; ++k) {
      const std::size_t next = (k + 1) % 3;
      const Index own = surface_.triangles(t, static_cast<Eigen::Index>(k)),
                  other = surface_.triangles(t, static_cast<Eigen::Index>(next));
      meet(surface_.vertex_elements[own], x[k], x[k], touch);
      // From the lower end, so that all cells see the same edge.
      meet(surface_.edge_elements(t, static_cast<Eigen::Index>(k)), own < other ? x[k] : x[next], own < other ? x[next] : x[k],
           touch);
    }
  }
  std::sort(result.borders.begin(), result.borders.end(),
            [](const BorderEdge& a, const BorderEdge& b) { return a.element < b.element; });
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
      corners[corner] = voxels.corner(surface, voxels.touch_triangles[k], static_cast<Eigen::Index>(corner));
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
