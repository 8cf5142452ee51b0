// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A volume of regular tets around any triangle surface: the cubes of a grid that the surface touches or encloses, six tets each
/// [DE 3.1 and the published data].
#pragma once

#include "followthrough/types.hpp"

namespace followthrough {

struct VoxelSettings {
  Index cells = 25;          ///< cubes along the longest side of the surface's bounding box; unused where `cell_size` is given
  double cell_size = 0;      ///< edge of a cube, m; 0: from `cells`
  bool split_parts = false;  ///< do not glue parts of the body that merely come near each other
};

/// Tets around a surface, and where the surface's vertices lie in them.
struct TetVolume {
  Positions vertices;          ///< (n,3) m, sorted by x, then y, then z
  Tets tets;                   ///< (m,4), six a cube, all of positive volume: det(x1 - x0, x2 - x0, x3 - x0) > 0
  Indices embedding_tets;      ///< (v,) the tet that holds each vertex of the surface
  Weights4 embedding_weights;  ///< (v,4) its barycentric weights there
  Index cell_count = 0;        ///< cubes kept; one that was split counts for each of its copies
  double cell_size = 0;        ///< edge of a cube, m
  Indices own_offsets;         ///< (n + 1,) rows of `own_triangles` of each vertex; empty unless parts were split
  Indices own_triangles;       ///< triangles of the surface that cross the cubes around a vertex and are of its own part
};

/// @brief Makes a volume of regular tets around a surface, which may be open, self-crossing, of many parts, non-manifold, with
/// unwelded seams, faces that are degenerate, doubled or turned, and parts that are inside out.
///
/// The grid has N x N x N cubes centred on the surface's bounding box. Kept are the cubes inside it that a triangle reaches into,
/// by more than a hundred-thousandth of an edge, and those whose centre has a generalized winding number above one half. Every
/// closed part counts as solid, whichever way its faces are turned.
///
/// With `split_parts`, a cube in which several parts of the body come near each other is there once for each part, and so are the
/// grid's vertices around it, so that each part moves on its own; see `split_parts` in src/mesh/part_splitting.hpp for the rule.
///
/// @param vertices (v,3) positions of the surface, m
/// @param triangles (t,3)
/// @param settings size of the grid
/// @throws InvalidInput naming the argument: an empty or non-finite surface, an index out of range, cells < 1, a cell_size that is
/// not
///   positive or so small that there would be more than 20 million cells
TetVolume tetrahedralize(ConstPositions vertices, ConstTriangles triangles, const VoxelSettings& settings = {});

/// @brief Finds the pieces that a tet mesh falls into; tets that share a vertex hang together.
/// @param tets (m,4)
/// @param vertex_count n
/// @return (n,) number of the piece of each vertex, counted from 0 in the order of their first vertices; -1 for vertices without a
/// tet
/// @throws InvalidInput where an index is out of range
Indices connected_parts(ConstTets tets, Eigen::Index vertex_count);

}  // namespace followthrough
