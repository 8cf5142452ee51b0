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
#include "part_splitting.hpp"
#include "prepared_surface.hpp"
#include "tet_weights.hpp"
#include "triangle_tree.hpp"
#include "voxels.hpp"

namespace followthrough {
namespace {

// Cells that hold a position, the one below first; several where it lies on a plane between them.
std::vector<Index> cells_at(const Eigen::Vector3d& position, const VoxelGrid& grid) {
  std::vector<Index> cells;
  const Eigen::Vector3d at = grid.to_grid(position);
  // A loose vertex may lie anywhere.
  if ((at - grid.low.cast<double>()).minCoeff() < -1 || (at - (grid.low + grid.size).cast<double>()).maxCoeff() > 1) return cells;
  for (int combination = 0; combination < 8; ++combination) {
    Eigen::Vector3i cell;
    bool another = true;
    for (int axis = 0; axis < 3; ++axis) {
      const double below = std::floor(at[axis] - kTouchDepth), above = std::floor(at[axis] + kTouchDepth);
      const bool up = combination >> axis & 1;
      another = another && !(up && above == below);
      cell[axis] = static_cast<int>(up ? above : below);
    }
    if (another && grid.contains(cell)) cells.push_back(grid.number(cell));
  }
  return cells;
}

// The cube that holds each vertex of the surface: of the cell that it lies in, or -1 where that was not kept.
std::vector<Index> cubes_of_vertices(ConstPositions vertices, const VoxelGrid& grid, const Cubes& cubes) {
  std::vector<Index> cube_of_cell(static_cast<std::size_t>(grid.count()), -1);
  for (std::size_t c = cubes.cells.size(); c-- > 0;) cube_of_cell[static_cast<std::size_t>(cubes.cells[c])] = static_cast<Index>(c);
  std::vector<Index> result(static_cast<std::size_t>(vertices.rows()), -1);
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    for (const Index cell : cells_at(vertices.row(v), grid)) {
      if (result[static_cast<std::size_t>(v)] < 0)
        result[static_cast<std::size_t>(v)] = cube_of_cell[static_cast<std::size_t>(cell)];
    }
  }
  return result;
}

// Where parts were split: the cube that carries the vertex's own triangles. Welded vertices share it.
void choose_own_cubes(const PreparedSurface& surface, const Voxels& voxels, const std::vector<Index>& touch_cubes,
                      std::vector<Index>& cubes) {
  std::vector<std::vector<Index>> around(static_cast<std::size_t>(surface.vertices.rows()));
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    for (int k = 0; k < 3; ++k) around[static_cast<std::size_t>(surface.triangles(t, k))].push_back(static_cast<Index>(t));
  }
  std::vector<Index> own(around.size(), -1);
  for (std::size_t v = 0; v < around.size(); ++v) {
    for (const Index cell : cells_at(surface.vertices.row(static_cast<Eigen::Index>(v)), voxels.grid)) {
      const auto first = voxels.touch_triangles.begin() + voxels.touch_offsets[static_cast<std::size_t>(cell)];
      const auto last = voxels.touch_triangles.begin() + voxels.touch_offsets[static_cast<std::size_t>(cell) + 1];
      for (const Index t : around[v]) {
        const auto found = std::lower_bound(first, last, t);
        if (own[v] < 0 && found != last && *found == t) {
          own[v] = touch_cubes[static_cast<std::size_t>(found - voxels.touch_triangles.begin())];
        }
      }
    }
  }
  for (std::size_t v = 0; v < cubes.size(); ++v) {
    const Index cube = own[static_cast<std::size_t>(surface.welded[static_cast<Eigen::Index>(v)])];
    if (cube >= 0) cubes[v] = cube;
  }
}

// Lists for each vertex of the volume the surface's triangles that its cubes carry.
void list_own_triangles(const PreparedSurface& surface, const Voxels& voxels, const std::vector<Index>& touch_cubes,
                        const CubeTets& cut, TetVolume& volume) {
  std::vector<std::vector<Index>> own(static_cast<std::size_t>(cut.vertices.rows()));
  for (std::size_t touch = 0; touch < touch_cubes.size(); ++touch) {
    for (const Index vertex : cut.corners[static_cast<std::size_t>(touch_cubes[touch])]) {
      own[static_cast<std::size_t>(vertex)].push_back(surface.sources[voxels.touch_triangles[touch]]);
    }
  }
  volume.own_offsets = Indices::Zero(cut.vertices.rows() + 1);
  std::vector<Index> all;
  for (std::size_t v = 0; v < own.size(); ++v) {
    std::sort(own[v].begin(), own[v].end());
    own[v].erase(std::unique(own[v].begin(), own[v].end()), own[v].end());
    all.insert(all.end(), own[v].begin(), own[v].end());
    volume.own_offsets[static_cast<Eigen::Index>(v) + 1] = static_cast<Index>(all.size());
  }
  volume.own_triangles = Eigen::Map<const Indices>(all.data(), static_cast<Eigen::Index>(all.size()));
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

  SplitCubes split;
  if (settings.split_parts) {
    split = split_parts(surface, tree, voxels);
  } else {
    split.cubes = plain_cubes(voxels);
  }
  CubeTets cut = cut_cubes(grid, split.cubes);
  std::vector<Index> carriers = cubes_of_vertices(vertices, grid, split.cubes);
  TetVolume volume;
  if (settings.split_parts) {
    choose_own_cubes(surface, voxels, split.touch_cubes, carriers);
    list_own_triangles(surface, voxels, split.touch_cubes, cut, volume);
  }
  volume.vertices = std::move(cut.vertices);
  volume.tets = std::move(cut.tets);
  volume.cell_count = static_cast<Index>(split.cubes.cells.size());
  volume.cell_size = grid.edge;
  embed_in_cubes(vertices, carriers, volume);
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
