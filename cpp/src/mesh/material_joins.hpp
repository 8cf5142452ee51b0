// SPDX-License-Identifier: GPL-3.0-or-later
// Which nodes of a cell are one part, because the same material lies between them.
#pragma once

#include "disjoint_sets.hpp"
#include "part_nodes.hpp"

namespace followthrough {

/// @brief Joins nodes of the same cell.
///
/// A stretch's pieces hang on the patches that it enters and leaves by. Lines of three directions meet in the points of a lattice;
/// there their stretches are the same material. What no line told is looked for: patches that see each other, or a point of the
/// lattice, through material.
/// @param nodes sets over all of `parts.count` nodes
void join_by_material(const PartNodes& parts, DisjointSets& nodes);

}  // namespace followthrough
