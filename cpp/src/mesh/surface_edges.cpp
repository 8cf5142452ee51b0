// SPDX-License-Identifier: GPL-3.0-or-later
#include "surface_edges.hpp"

#include <algorithm>

#include "bucket_sort.hpp"

namespace followthrough {

std::vector<DirectedEdge> sorted_edges(ConstTriangles triangles, Eigen::Index vertex_count) {
  std::vector<DirectedEdge> edges;
  edges.reserve(3 * static_cast<std::size_t>(triangles.rows()));
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    const Index corners[] = {triangles(t, 0), triangles(t, 1), triangles(t, 2)};
    if (corners[0] == corners[1] || corners[1] == corners[2] || corners[2] == corners[0]) continue;
    for (int k = 0; k < 3; ++k) {
      const Index a = corners[k], b = corners[(k + 1) % 3];
      edges.push_back({std::min(a, b), std::max(a, b), static_cast<Index>(t), a < b ? 1 : -1});
    }
  }
  return bucket_sorted(
      edges, static_cast<std::size_t>(vertex_count), [](const DirectedEdge& edge) { return edge.low; },
      [](const DirectedEdge& a, const DirectedEdge& b) { return a.high < b.high; });
}

void update_directions(ConstTriangles triangles, std::vector<DirectedEdge>& edges) {
  for (DirectedEdge& edge : edges) {
    const auto corners = triangles.row(edge.triangle);
    const int low = corners[0] == edge.low ? 0 : (corners[1] == edge.low ? 1 : 2);
    edge.direction = corners[(low + 1) % 3] == edge.high ? 1 : -1;
  }
}

}  // namespace followthrough
