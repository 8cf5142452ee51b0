// SPDX-License-Identifier: GPL-3.0-or-later
// Lines through the grid along the three axes, and the stretches of material on them.
#pragma once

#include <array>
#include <vector>

#include "prepared_surface.hpp"
#include "triangle_tree.hpp"
#include "voxels.hpp"

namespace followthrough {

/// Lines a cell and axis: a lattice of so many points cubed in each cell.
inline constexpr int kLinesPerCell = 4;

/// Where the lattice's points lie in each cell, in cell edges: nearly even, but off the planes that meshes like to lie in.
inline double lattice_place(int axis, int index) {
  constexpr std::array<double, 3> kOffsets = {0.4836917, 0.5127311, 0.4968423};
  return (index + kOffsets[static_cast<std::size_t>(axis)]) / kLinesPerCell;
}

/// A stretch of one line inside the body, between two crossings of the surface.
struct Stretch {
  int axis;         ///< the line's direction
  int u, v;         ///< its lattice rows along axes (axis + 1) % 3 and (axis + 2) % 3, from the grid's corner
  double from, to;  ///< in cell edges along the axis
  Index enter;      ///< triangle whose material begins here; -1 where the stretch begins because an overlap ends
  Index exit;       ///< triangle whose material ends here; -1 where the stretch ends because an overlap begins
  Index shell;      ///< shell of the surface, see PreparedSurface
  bool overlap;     ///< the line is inside this shell more than once: parts of it overlap here
};

/// @brief Finds all stretches of material, shell by shell.
///
/// In a closed shell crossings are counted; regions that a self-crossing turned inside out count as inside. In one with holes a
/// stretch also ends, without a result, where the winding number (of an untouched cell: at its centre) says that the line is
/// outside. Where walls divide a shell, the winding number alone decides.
std::vector<Stretch> find_stretches(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels);

}  // namespace followthrough
