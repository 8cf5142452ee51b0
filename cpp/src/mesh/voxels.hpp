// SPDX-License-Identifier: GPL-3.0-or-later
// Which cubes of a grid a surface touches or encloses.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "followthrough/types.hpp"
#include "prepared_surface.hpp"
#include "triangle_tree.hpp"

namespace followthrough {

/// How deep, in cell edges, a surface must reach into a cell to touch it. Faces that lie on a grid plane up to rounding (every
/// bounding box's do) so never touch the cell beyond it, wherever the rounding of a translation or rotation puts them.
inline constexpr double kTouchDepth = 1e-5;

/// The whole number below, for numbers of an Index's range: without the library call that std::floor is on the simplest processors.
inline int floor_index(double value) {
  const int truncated = static_cast<int>(value);
  return truncated - (value < truncated);
}

/// N x N x N cubes centred on the surface's bounding box. Only the cells from `low`, `size` of them, are ever looked at: the others
/// lie outside the bounding box.
struct VoxelGrid {
  Eigen::Vector3d centre;
  double edge = 0;
  Index cells = 0;
  Eigen::Vector3i low;
  Eigen::Vector3i size;

  /// Position in cell edges, from the corner of cell (0, 0, 0).
  Eigen::Vector3d to_grid(const Eigen::Vector3d& position) const {
    return (position - centre) / edge + Eigen::Vector3d::Constant(0.5 * cells);
  }
  Eigen::Vector3d from_grid(const Eigen::Vector3d& position) const {
    return centre + edge * (position - Eigen::Vector3d::Constant(0.5 * cells));
  }
  bool contains(const Eigen::Vector3i& cell) const {
    return ((cell - low).array() >= 0).all() && ((cell - low - size).array() < 0).all();
  }
  /// Number of a cell; sorted by x, then y, then z.
  Index number(const Eigen::Vector3i& cell) const {
    const Eigen::Vector3i local = cell - low;
    return (local[0] * size[1] + local[1]) * size[2] + local[2];
  }
  Eigen::Vector3i cell(Index number) const {
    return low + Eigen::Vector3i(number / (size[1] * size[2]), number / size[2] % size[1], number % size[2]);
  }
  Index count() const { return size[0] * size[1] * size[2]; }
};

/// @param cells cells along the longest side; used where `cell_size` is 0
/// @param cell_size edge of a cube; the number along the longest side is then the smallest that covers it
/// @throws InvalidInput naming `cells` or `cell_size` where that is not positive or makes more cells than memory is meant for
VoxelGrid make_grid(const PreparedSurface& surface, Index cells, double cell_size);

struct Voxels {
  VoxelGrid grid;
  Positions positions;                 ///< the prepared surface's vertices in the grid, in cell edges
  std::vector<char> kept;              ///< one a cell number
  std::vector<char> enclosed;          ///< kept because the centre is inside; not decided for touched cells
  std::vector<Index> touch_offsets;    ///< (cells + 1): rows of `touch_triangles` of each cell
  std::vector<Index> touch_triangles;  ///< triangles of the prepared surface, ascending in each cell

  /// Corner k of a triangle, in the grid.
  Eigen::Vector3d corner(const PreparedSurface& surface, Eigen::Index triangle, Eigen::Index k) const {
    return positions.row(surface.triangles(triangle, k));
  }
  bool touched(Index cell) const {
    return touch_offsets[static_cast<std::size_t>(cell)] != touch_offsets[static_cast<std::size_t>(cell) + 1];
  }
};

/// @brief Cells that a triangle touches, and untouched ones whose centre has a winding number above one half.
///
/// On a closed surface the winding number is the same in all cells that hang together without the surface between them, and is
/// asked once for each such group; on an open one it is asked for every cell. Where all is closed, regions that a self-crossing
/// turned inside out (winding number below minus one half) count as inside too. A sheet that lies in a grid plane and so reaches
/// into no cell keeps the cells on its inner side, unless those on the other side are kept anyway.
Voxels voxelize(const PreparedSurface& surface, const TriangleTree& tree, const VoxelGrid& grid);

/// Whether a triangle meets the cube of half edge `half` around `centre`: the thirteen separating axes.
bool triangle_meets_cube(const std::array<Eigen::Vector3d, 3>& corners, const Eigen::Vector3d& centre, double half);

}  // namespace followthrough
