// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Which vertices the network looks at, in an order that keeps neighbours near each other in memory.
#pragma once

#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// The neighbours of every free vertex that are so many edges away.
struct Ring {
  std::vector<Index> starts;  ///< (free vertices + 1,) into neighbours
  std::vector<Index>
      neighbours;  ///< rows of Patches::vertices; in the order of the vertices' own numbers, whatever the rows' order
};

struct Patches {
  std::vector<Index> vertices;  ///< those in a patch of a free vertex, along a Morton curve through the rest shape
  std::vector<Index> free;      ///< rows of `vertices` that are free, ascending
  std::vector<Ring> rings;
};

/// @param rest_positions (n,3)
/// @param tets (m,4); two vertices of a tet are one edge apart
/// @param constrained (n,)
/// @param ring_count rings around every free vertex
Patches find_patches(ConstPositions rest_positions, ConstTets tets, ConstMask constrained, int ring_count);

}  // namespace followthrough
