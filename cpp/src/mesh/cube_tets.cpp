// SPDX-License-Identifier: GPL-3.0-or-later
#include "cube_tets.hpp"

#include "bucket_sort.hpp"

namespace followthrough {

CubeTets cut_cubes(const VoxelGrid& grid, const Cubes& cubes) {
  struct Corner {
    Index place, node, cube;
    int k;
  };
  std::vector<Corner> sorted;
  sorted.reserve(8 * cubes.cells.size());
  for (std::size_t c = 0; c < cubes.cells.size(); ++c) {
    const Eigen::Vector3i cell = grid.cell(cubes.cells[c]);
    for (int k = 0; k < 8; ++k) {
      sorted.push_back(
          {grid_node(grid, cell + cube_corner(k)), cubes.nodes[c][static_cast<std::size_t>(k)], static_cast<Index>(c), k});
    }
  }
  const Eigen::Vector3i planes = grid.size + Eigen::Vector3i::Ones();
  sorted = bucket_sorted(
      sorted, static_cast<std::size_t>(planes.prod()), [](const Corner& corner) { return corner.place; },
      [](const Corner& a, const Corner& b) { return a.node < b.node; });  // cubes are in order already

  CubeTets result;
  result.corners.resize(cubes.cells.size());
  std::vector<Eigen::Vector3d> positions;
  for (std::size_t s = 0; s < sorted.size(); ++s) {
    const Corner& corner = sorted[s];
    if (s == 0 || corner.place != sorted[s - 1].place || corner.node != sorted[s - 1].node) {
      const Eigen::Vector3i at = grid.cell(cubes.cells[static_cast<std::size_t>(corner.cube)]) + cube_corner(corner.k);
      positions.push_back(grid.from_grid(at.cast<double>()));
    }
    result.corners[static_cast<std::size_t>(corner.cube)][static_cast<std::size_t>(corner.k)] =
        static_cast<Index>(positions.size()) - 1;
  }
  result.vertices.resize(static_cast<Eigen::Index>(positions.size()), 3);
  for (std::size_t v = 0; v < positions.size(); ++v) result.vertices.row(static_cast<Eigen::Index>(v)) = positions[v];
  result.tets.resize(6 * static_cast<Eigen::Index>(cubes.cells.size()), 4);
  for (std::size_t c = 0; c < cubes.cells.size(); ++c) {
    for (std::size_t t = 0; t < 6; ++t) {
      for (std::size_t k = 0; k < 4; ++k) {
        result.tets(static_cast<Eigen::Index>(6 * c + t), static_cast<Eigen::Index>(k)) =
            result.corners[c][static_cast<std::size_t>(kCubeTets[t][k])];
      }
    }
  }
  return result;
}

Cubes plain_cubes(const Voxels& voxels) {
  Cubes cubes;
  for (Index cell = 0; cell < voxels.grid.count(); ++cell) {
    if (!voxels.kept[static_cast<std::size_t>(cell)]) continue;
    cubes.cells.push_back(cell);
    auto& nodes = cubes.nodes.emplace_back();
    for (int k = 0; k < 8; ++k) {
      nodes[static_cast<std::size_t>(k)] = grid_node(voxels.grid, voxels.grid.cell(cell) + cube_corner(k));
    }
  }
  return cubes;
}

}  // namespace followthrough
