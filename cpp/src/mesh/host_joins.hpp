// SPDX-License-Identifier: GPL-3.0-or-later
// Pieces of the mesh (eyes, clothes, buttons) that overlap nothing, glued to the nearest larger one.
#pragma once

#include <utility>
#include <vector>

#include "disjoint_sets.hpp"
#include "part_nodes.hpp"

namespace followthrough {

/// Rows of the touch lists in neighbouring cells, by two, whose cubes must share their corners.
using NeighbourJoins = std::vector<std::pair<std::size_t, std::size_t>>;

/// @brief Joins each node whose triangles are of a smaller piece of the mesh to what carries the nearest triangle of a larger one,
/// where that is no farther than a cell's edge: in the same cell here, in a neighbouring one by what is returned.
/// @param nodes sets over all of `parts.count` nodes
NeighbourJoins join_pieces_of_mesh(const PartNodes& parts, DisjointSets& nodes);

}  // namespace followthrough
