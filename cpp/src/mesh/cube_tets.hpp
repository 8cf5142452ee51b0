// SPDX-License-Identifier: GPL-3.0-or-later
// Six tets a cube, and the numbering of their vertices.
#pragma once

#include <array>
#include <vector>

#include "followthrough/types.hpp"
#include "voxels.hpp"

namespace followthrough {

/// Corner k of a cube is the one at (k >> 2 & 1, k >> 1 & 1, k & 1), x y z: corners in ascending order are sorted by x, then y,
/// then z.
inline Eigen::Vector3i cube_corner(int k) { return {k >> 2 & 1, k >> 1 & 1, k & 1}; }

/// Tets of a cube by its corners, in the order of the published data (corner offsets x y z: 000 100 010 001 and so on). All have
/// positive volume, and cubes side by side meet in whole faces.
inline constexpr std::array<std::array<int, 4>, 6> kCubeTets = {
    {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}}};

/// Cubes that become tets: each cell once, or once for each part where parts were split.
struct Cubes {
  std::vector<Index> cells;                 ///< cell numbers, ascending
  std::vector<std::array<Index, 8>> nodes;  ///< which grid vertex each corner is; equal numbers are one vertex of the volume
};

struct CubeTets {
  Positions vertices;
  Tets tets;
  std::vector<std::array<Index, 8>> corners;  ///< vertex of each corner of each cube
};

/// Numbers the vertices by x, y, z and then node, and cuts each cube in six.
CubeTets cut_cubes(const VoxelGrid& grid, const Cubes& cubes);

/// The kept cells as they are: corners at the same place are one.
Cubes plain_cubes(const Voxels& voxels);

/// Number of a grid vertex; sorted by x, then y, then z.
inline Index grid_node(const VoxelGrid& grid, const Eigen::Vector3i& corner) {
  const Eigen::Vector3i local = corner - grid.low;
  return (local[0] * (grid.size[1] + 1) + local[1]) * (grid.size[2] + 1) + local[2];
}

}  // namespace followthrough
