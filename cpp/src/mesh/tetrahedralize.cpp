// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/tetrahedralize.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "cube_tets.hpp"
#include "disjoint_sets.hpp"
#include "followthrough/errors.hpp"
#include "followthrough/mesh/embedding.hpp"
#include "prepared_surface.hpp"
#include "tet_weights.hpp"
#include "triangle_tree.hpp"
#include "voxels.hpp"

namespace followthrough {
namespace {

// The cube that holds each vertex of the surface: the cell that it lies in, or -1 where that was not kept.
std::vector<Index> cubes_of_vertices(ConstPositions vertices, const VoxelGrid& grid, const Cubes& cubes) {
  std::vector<Index> cube_of_cell(static_cast<std::size_t>(grid.count()), -1);
  for (std::size_t c = cubes.cells.size(); c-- > 0;) cube_of_cell[static_cast<std::size_t>(cubes.cells[c])] = static_cast<Index>(c);
  std::vector<Index> result(static_cast<std::size_t>(vertices.rows()), -1);
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    const Eigen::Vector3d at = grid.to_grid(vertices.row(v));
    if ((at - grid.low.cast<double>()).minCoeff() < -1 || (at - (grid.low + grid.size).cast<double>()).maxCoeff() > 1) continue;
    // On a plane between two cells the first kept one counts.
    for (int combination = 0; combination < 8; ++combination) {
      Eigen::Vector3i cell;
      bool wanted = true;
      for (int axis = 0; axis < 3; ++axis) {
        const double below = at[axis] - kTouchDepth, above = at[axis] + kTouchDepth;
        cell[axis] = static_cast<int>(std::floor(combination >> axis & 1 ? above : below));
        if ((combination >> axis & 1) && std::floor(above) == std::floor(below)) wanted = false;
      }
      if (!wanted || !grid.contains(cell)) continue;
      result[static_cast<std::size_t>(v)] = cube_of_cell[static_cast<std::size_t>(grid.number(cell))];
      if (result[static_cast<std::size_t>(v)] >= 0) break;
    }
  }
  return result;
}

// Embeds each vertex in the best of its cube's six tets; vertices without a cube (loose ones) in the nearest tet there is.
void embed_in_cubes(ConstPositions points, const std::vector<Index>& cubes, TetVolume& volume) {
  volume.embedding_tets.resize(points.rows());
  volume.embedding_weights.resize(points.rows(), 4);
  std::vector<Index> loose;
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    const Index cube = cubes[static_cast<std::size_t>(p)];
    if (cube < 0) {
      loose.push_back(static_cast<Index>(p));
      continue;
    }
    double best = -std::numeric_limits<double>::infinity();
    for (Index tet = 6 * cube; tet < 6 * cube + 6; ++tet) {
      const TetCorners x = {volume.vertices.row(volume.tets(tet, 0)), volume.vertices.row(volume.tets(tet, 1)),
                            volume.vertices.row(volume.tets(tet, 2)), volume.vertices.row(volume.tets(tet, 3))};
      const Eigen::Vector4d weights = tet_weights(points.row(p), x);
      const double least = std::min(weights.minCoeff(), 0.0);
      if (least > best + 1e-12) {
        best = least;
        volume.embedding_tets[p] = tet;
        volume.embedding_weights.row(p) = weights;
      }
    }
  }
  if (loose.empty()) return;
  Positions rest(static_cast<Eigen::Index>(loose.size()), 3);
  for (std::size_t k = 0; k < loose.size(); ++k) rest.row(static_cast<Eigen::Index>(k)) = points.row(loose[k]);
  const Embedding embedding = embed(rest, volume.vertices, volume.tets);
  for (std::size_t k = 0; k < loose.size(); ++k) {
    volume.embedding_tets[loose[k]] = embedding.tets[static_cast<Eigen::Index>(k)];
    volume.embedding_weights.row(loose[k]) = embedding.weights.row(static_cast<Eigen::Index>(k));
  }
}

}  // namespace

TetVolume tetrahedralize(ConstPositions vertices, ConstTriangles triangles, const VoxelSettings& settings) {
  const PreparedSurface surface = prepare_surface(vertices, triangles);
  const VoxelGrid grid = make_grid(surface, settings.cells, settings.cell_size);
  const TriangleTree tree(surface.vertices, surface.triangles);
  const Voxels voxels = voxelize(surface, tree, grid);

  const Cubes cubes = plain_cubes(voxels);
  CubeTets cut = cut_cubes(grid, cubes);
  TetVolume volume;
  volume.vertices = std::move(cut.vertices);
  volume.tets = std::move(cut.tets);
  volume.cell_count = static_cast<Index>(cubes.cells.size());
  volume.cell_size = grid.edge;
  embed_in_cubes(vertices, cubes_of_vertices(vertices, grid, cubes), volume);
  return volume;
}

Indices connected_parts(ConstTets tets, Eigen::Index vertex_count) {
  require_indices("tets", tets, vertex_count);
  DisjointSets sets(static_cast<std::size_t>(vertex_count));
  std::vector<char> used(static_cast<std::size_t>(vertex_count), 0);
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    for (int k = 0; k < 4; ++k) {
      sets.join(tets(t, 0), tets(t, k));
      used[static_cast<std::size_t>(tets(t, k))] = 1;
    }
  }
  Indices parts = Indices::Constant(vertex_count, -1);
  Index count = 0;
  for (Eigen::Index v = 0; v < vertex_count; ++v) {
    if (!used[static_cast<std::size_t>(v)]) continue;
    const Index root = sets.find(static_cast<Index>(v));
    parts[v] = root == v ? count++ : parts[root];
  }
  return parts;
}

}  // namespace followthrough
