// SPDX-License-Identifier: GPL-3.0-or-later
// The surface inside one cell: which of its triangles hang together there, and what sees what through the material.
#pragma once

#include <array>
#include <vector>

#include "prepared_surface.hpp"
#include "voxels.hpp"

namespace followthrough {

/// An edge of the surface (or a vertex, where both ends are the same) that reaches the border of a cell.
struct BorderEdge {
  Index element;      ///< its number, see PreparedSurface
  std::size_t touch;  ///< row of Voxels::touch_triangles of a triangle at it
};

struct CellPatches {
  std::vector<Index> labels;  ///< patch of each triangle of the cell's touch list, counted from 0
  Index count = 0;
  std::vector<BorderEdge> borders;  ///< sorted by `element`
};

/// Groups the triangles that touch a cell by what they share inside that cell: an edge that passes through it or a vertex in it.
class PatchFinder {
 public:
  PatchFinder(const PreparedSurface& surface, const Voxels& voxels);

  CellPatches operator()(Index cell);

 private:
  struct Seen {
    Index cell = -1;  // the last one in which this element was seen
    Index first;      // its first triangle there, counted in the cell; -1: it does not reach into the cell
  };

  const PreparedSurface& surface_;
  const Voxels& voxels_;
  std::vector<Seen> seen_;  // one an element
};

/// Looks through the material of one cell. Positions are in cell edges.
class CellView {
 public:
  CellView(const PreparedSurface& surface, const Voxels& voxels, Index cell);

  /// A point of the cell just below a triangle's surface, on its inner side; false where the triangle has no area there.
  bool point_below(std::size_t triangle, Eigen::Vector3d& point) const;

  /// @brief Whether one looks from below triangle `start` at `from`, where two parts overlap, to `to`, where only the first one of
  /// them is: no triangle is in between but one of the other part's, which faces the other way and is passed from inside out.
  bool sees_out_of_overlap(std::size_t start, const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;

  /// Whether no triangle comes between two points of the cell.
  bool sees(const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;

 private:
  bool between(std::size_t triangle, const Eigen::Vector3d& from, const Eigen::Vector3d& to) const;
  Eigen::Vector3d normal(std::size_t triangle) const;

  Eigen::Vector3d centre_;
  std::vector<std::array<Eigen::Vector3d, 3>> triangles_;
};

}  // namespace followthrough
