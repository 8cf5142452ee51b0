// SPDX-License-Identifier: GPL-3.0-or-later
// The edges of a triangle surface, each with its faces.
#pragma once

#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// One face of an edge.
struct DirectedEdge {
  Index low, high, triangle;
  int direction;  ///< +1: the face runs from low to high
};

/// Three a triangle, none of one with a repeated corner; sorted by `low`, `high`, `triangle`.
std::vector<DirectedEdge> sorted_edges(ConstTriangles triangles, Eigen::Index vertex_count);

/// Sets the directions anew, after triangles were turned.
void update_directions(ConstTriangles triangles, std::vector<DirectedEdge>& edges);

/// Calls visit(first, last) for the faces of each edge.
template <typename Visit>
void for_each_edge(const std::vector<DirectedEdge>& edges, Visit&& visit) {
  for (std::size_t first = 0, last = 0; first < edges.size(); first = last) {
    while (last < edges.size() && edges[last].low == edges[first].low && edges[last].high == edges[first].high) ++last;
    visit(first, last);
  }
}

}  // namespace followthrough
