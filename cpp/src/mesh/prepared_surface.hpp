// SPDX-License-Identifier: GPL-3.0-or-later
// Any triangle soup made fit for asking what is inside it: welded, each face once, faces that lie side by side turned the same way,
// and parts that were inside out turned outside.
#pragma once

#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// How a line through the surface tells where it is inside.
enum class Crossings {
  kCount,         ///< closed: going in and coming out again balance
  kCountInside,   ///< manifold with holes: they balance, except where the line passes through a hole
  kAskEverywhere  ///< walls and fins, at edges of three faces and more: only the winding number knows
};

struct PreparedSurface {
  Positions vertices;   ///< (u,3) distinct positions
  Indices welded;       ///< (v,) row in `vertices` of every vertex of the input
  Triangles triangles;  ///< (k,3) rows in `vertices`: no face twice, none with a repeated corner
  Indices sources;      ///< (k,) the input's triangle that each one was
  Indices components;   ///< (k,) pieces of the mesh that share no vertex, counted from 0
  Index component_count = 0;
  Indices shells;                          ///< (k,) sets of triangles whose crossings belong together, counted from 0
  std::vector<Crossings> shell_crossings;  ///< one a shell
  Indices vertex_elements;  ///< (u,) number of each vertex in one list of all vertices and edges, sorted by their lower end
  Triangles edge_elements;  ///< (k,3) number in that list of the edge from each corner to the next one
  Index element_count = 0;
  bool closed = false;  ///< every edge is passed as often one way as the other, so winding numbers are whole numbers
};

/// @brief Cleans a surface.
///
/// Vertices on open borders are welded where they are closer than 1e-6 of the longest side. Of faces with the same corners the
/// first counts. Across edges of exactly two faces, orientation is carried on, by majority of area where that turns some faces
/// round. A patch that is closed, or bent enough to enclose something, is turned so that its volume is positive; a flat one stays
/// as it was. So every closed part is solid, whichever way it was turned, also inside another one: closed hollows count as filled,
/// as they do when one fills from outside.
///
/// @throws InvalidInput naming `vertices` or `triangles`: empty, not finite, index out of range, no extent
PreparedSurface prepare_surface(ConstPositions vertices, ConstTriangles triangles);

}  // namespace followthrough
