// SPDX-License-Identifier: GPL-3.0-or-later
// What a cell may hold of the body, bit by bit: the nodes that part splitting joins to parts.
#pragma once

#include <utility>
#include <vector>

#include "cell_patches.hpp"
#include "depth_lines.hpp"
#include "prepared_surface.hpp"
#include "triangle_tree.hpp"
#include "voxels.hpp"

namespace followthrough {

/// @brief All nodes, numbered from 0. A node is a patch of a cell's surface, a stretch's piece in a touched cell, or a whole
/// untouched cell.
///
/// Every node lies in one cell, and only nodes of the same cell are ever joined.
struct PartNodes {
  static constexpr Index kNone = -1;

  /// Refers to all three, which must outlive this.
  PartNodes(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels);

  bool kept(Index cell) const { return voxels.kept[static_cast<std::size_t>(cell)]; }
  std::size_t touch_begin(Index cell) const {
    return static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell)]);
  }
  std::size_t touch_end(Index cell) const {
    return static_cast<std::size_t>(voxels.touch_offsets[static_cast<std::size_t>(cell) + 1]);
  }

  /// Row of the cell's touch list that holds a triangle, or the list's end.
  std::size_t touch_of(Index cell, Index triangle) const;

  Index cell_on(const Stretch& stretch, int along) const;

  /// The node of a stretch in one of its cells; kNone where that cell was not kept.
  Index node_on(std::size_t stretch, int along) const;

  const PreparedSurface& surface;
  const TriangleTree& tree;
  const Voxels& voxels;
  const VoxelGrid& grid;
  std::size_t count = 0;
  std::vector<Stretch> stretches;
  std::vector<int> first_cells, last_cells;      ///< of each stretch, along its axis
  std::vector<Index> first_pieces;               ///< node of each stretch's first cell
  std::vector<Index> touched;                    ///< cells with triangles
  std::vector<Index> ordinal;                    ///< place of each cell in `touched`
  std::vector<std::vector<BorderEdge>> borders;  ///< of each touched cell
  std::vector<Index> touch_nodes;                ///< node of each row of the touch lists
  std::vector<Index> cell_nodes;                 ///< node of each kept cell without triangles

 private:
  void number_patches();
  void drop_shallow_overlaps();
  void number_pieces();
  std::pair<int, int> cells_along(const Stretch& stretch) const;
};

}  // namespace followthrough
