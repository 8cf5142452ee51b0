// SPDX-License-Identifier: GPL-3.0-or-later
#include "boundary_anchors.hpp"

#include <optional>

#include "followthrough/errors.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {

void require_surface_and_tets(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets) {
  require_finite("surface_vertices", surface_vertices);
  if (triangles.rows() == 0) throw InvalidInput("triangles", "is empty, expected at least one triangle");
  require_indices("triangles", triangles, surface_vertices.rows());
  require_finite("vertices", vertices);
  require_indices("tets", tets, vertices.rows());
}

std::vector<ClosestPoint> boundary_anchors(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices,
                                           const Mask& wanted, ConstIndices own_offsets, ConstIndices own_triangles) {
  if (own_offsets.size() > 0) {
    require_rows("own_offsets", own_offsets.size(), vertices.rows() + 1);
    require_indices("own_offsets", own_offsets, own_triangles.size() + 1);
    require_indices("own_triangles", own_triangles, triangles.rows());
  }
  std::vector<Index> asking;
  for (Eigen::Index v = 0; v < wanted.size(); ++v) {
    if (wanted[v]) asking.push_back(static_cast<Index>(v));
  }
  // Hardly any vertex of a split volume needs the tree: it has triangles of its own.
  std::optional<TriangleTree> tree;
  for (const Index v : asking) {
    if (!tree && (own_offsets.size() == 0 || own_offsets[v] == own_offsets[v + 1])) tree.emplace(surface_vertices, triangles);
  }
  std::vector<ClosestPoint> anchors(asking.size());
#pragma omp parallel for schedule(dynamic, 64) num_threads(worthwhile_threads(std::ssize(asking), 2'000))
  for (std::size_t k = 0; k < asking.size(); ++k) {
    const Eigen::Vector3d point = vertices.row(asking[k]);
    if (own_offsets.size() > 0) {
      for (Index at = own_offsets[asking[k]]; at < own_offsets[asking[k] + 1]; ++at) {
        const Index t = own_triangles[at];
        const Eigen::Vector3d a = surface_vertices.row(triangles(t, 0)), b = surface_vertices.row(triangles(t, 1)),
                              c = surface_vertices.row(triangles(t, 2));
        // No nearer than its box, give or take rounding.
        const Box box(a.cwiseMin(b).cwiseMin(c), a.cwiseMax(b).cwiseMax(c));
        if (anchors[k].triangle >= 0 && box.squaredExteriorDistance(point) > 1.000001 * anchors[k].squared_distance) continue;
        ClosestPoint candidate = closest_on_triangle(point, a, b, c);
        candidate.triangle = t;
        if (anchors[k].triangle < 0 || candidate.squared_distance < anchors[k].squared_distance) anchors[k] = candidate;
      }
    }
    if (anchors[k].triangle < 0) anchors[k] = tree->closest(point);
  }
  return anchors;
}

}  // namespace followthrough
