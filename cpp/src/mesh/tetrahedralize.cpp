// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/tetrahedralize.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <span>
#include <utility>
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
struct CellsAt {
  std::array<Index, 8> list;
  std::size_t count = 0;
  const Index* begin() const { return list.data(); }
  const Index* end() const { return list.data() + count; }
};

CellsAt cells_at(const Eigen::Vector3d& position, const VoxelGrid& grid) {
  CellsAt cells;
  const Eigen::Vector3d at = grid.to_grid(position);
  // A loose vertex may lie anywhere.
  if ((at - grid.low.cast<double>()).minCoeff() < -1 || (at - (grid.low + grid.size).cast<double>()).maxCoeff() > 1) return cells;
  Eigen::Vector3i below, above;
  for (int axis = 0; axis < 3; ++axis) {
    below[axis] = floor_index(at[axis] - kTouchDepth);
    above[axis] = floor_index(at[axis] + kTouchDepth);
  }
  for (int combination = 0; combination < 8; ++combination) {
    Eigen::Vector3i cell;
    bool another = true;
    for (int axis = 0; axis < 3; ++axis) {
      const bool up = combination >> axis & 1;
      another = another && !(up && above[axis] == below[axis]);
      cell[axis] = up ? above[axis] : below[axis];
    }
    if (another && grid.contains(cell)) cells.list[cells.count++] = grid.number(cell);
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

// Rows of `items` by number, in ascending order: those of number n are rows[offsets[n]] to rows[offsets[n + 1] - 1].
struct RowsByNumber {
  std::vector<Index> offsets, rows;

  template <typename NumberOf>
  RowsByNumber(std::size_t numbers, std::size_t items, NumberOf&& number_of) : offsets(numbers + 2, 0), rows(items) {
    for (std::size_t item = 0; item < items; ++item) ++offsets[static_cast<std::size_t>(number_of(item)) + 2];
    for (std::size_t n = 2; n < offsets.size(); ++n) offsets[n] += offsets[n - 1];
    for (std::size_t item = 0; item < items; ++item)
      rows[static_cast<std::size_t>(offsets[static_cast<std::size_t>(number_of(item)) + 1]++)] = static_cast<Index>(item);
  }
  std::span<const Index> of(std::size_t number) const {
    return std::span(rows).subspan(static_cast<std::size_t>(offsets[number]),
                                   static_cast<std::size_t>(offsets[number + 1] - offsets[number]));
  }
};

// Faces in a plane of the grid reach into no cell. In a cell of several cubes their vertices go where a neighbour on the surface
// is: into the cube that shares most corners with the neighbour's.
void follow_neighbours(const PreparedSurface& surface, const VoxelGrid& grid, const Cubes& cubes, const RowsByNumber& around,
                       std::vector<Index>& own) {
  const auto copies = [&](Index cell) {
    const auto range = std::equal_range(cubes.cells.begin(), cubes.cells.end(), cell);
    return std::pair(static_cast<Index>(range.first - cubes.cells.begin()), static_cast<Index>(range.second - cubes.cells.begin()));
  };
  std::vector<std::size_t> open;
  for (std::size_t v = 0; v < own.size(); ++v) {
    if (own[v] >= 0 || around.of(v).empty()) continue;
    for (const Index cell : cells_at(surface.vertices.row(static_cast<Eigen::Index>(v)), grid)) {
      const auto [first, last] = copies(cell);
      if (last - first < 2) continue;
      open.push_back(v);
      break;
    }
  }
  for (bool further = true; further;) {
    std::vector<std::pair<std::size_t, Index>> found;
    for (const std::size_t v : open) {
      Index best = -1;
      std::ptrdiff_t most = 0;
      for (const Index corner : around.of(v)) {
        for (int k = 0; k < 3; ++k) {
          const Index beside = own[static_cast<std::size_t>(surface.triangles(corner / 3, k))];
          if (beside < 0) continue;
          const auto& there = cubes.nodes[static_cast<std::size_t>(beside)];
          for (const Index cell : cells_at(surface.vertices.row(static_cast<Eigen::Index>(v)), grid)) {
            const auto [first, last] = copies(cell);
            for (Index cube = first; cube < last; ++cube) {
              const auto& here = cubes.nodes[static_cast<std::size_t>(cube)];
              const auto shared = std::count_if(
                  here.begin(), here.end(), [&](Index node) { return std::find(there.begin(), there.end(), node) != there.end(); });
              if (shared > most) {
                most = shared;
                best = cube;
              }
            }
          }
        }
      }
      if (best >= 0) found.emplace_back(v, best);
    }
    for (const auto& [v, cube] : found) own[v] = cube;
    std::erase_if(open, [&](std::size_t v) { return own[v] >= 0; });
    further = !found.empty();
  }
}

// Where parts were split: the cube that carries the vertex's own triangles. Welded vertices share it.
void choose_own_cubes(const PreparedSurface& surface, const Voxels& voxels, const SplitCubes& split, std::vector<Index>& cubes) {
  const std::vector<Index>& touch_cubes = split.touch_cubes;
  const auto corners = static_cast<std::size_t>(surface.triangles.size());
  const RowsByNumber around(static_cast<std::size_t>(surface.vertices.rows()), corners,
                            [&](std::size_t corner) { return surface.triangles.data()[corner]; });
  std::vector<Index> own(static_cast<std::size_t>(surface.vertices.rows()), -1);
  for (std::size_t v = 0; v < own.size(); ++v) {
    for (const Index cell : cells_at(surface.vertices.row(static_cast<Eigen::Index>(v)), voxels.grid)) {
      const auto first = voxels.touch_triangles.begin() + voxels.touch_offsets[static_cast<std::size_t>(cell)];
      const auto last = voxels.touch_triangles.begin() + voxels.touch_offsets[static_cast<std::size_t>(cell) + 1];
      for (const Index corner : around.of(v)) {
        if (own[v] >= 0) break;
        const auto found = std::lower_bound(first, last, corner / 3);
        if (found != last && *found == corner / 3) {
          own[v] = touch_cubes[static_cast<std::size_t>(found - voxels.touch_triangles.begin())];
        }
      }
    }
  }
  follow_neighbours(surface, voxels.grid, split.cubes, around, own);
  for (std::size_t v = 0; v < cubes.size(); ++v) {
    const Index cube = own[static_cast<std::size_t>(surface.welded[static_cast<Eigen::Index>(v)])];
    if (cube >= 0) cubes[v] = cube;
  }
}

// Lists for each vertex of the volume the surface's triangles that its cubes carry.
void list_own_triangles(const PreparedSurface& surface, const Voxels& voxels, const std::vector<Index>& touch_cubes,
                        const CubeTets& cut, TetVolume& volume) {
  const RowsByNumber touches(static_cast<std::size_t>(surface.triangles.rows()), touch_cubes.size(),
                             [&](std::size_t touch) { return voxels.touch_triangles[touch]; });
  std::vector<Index> last(static_cast<std::size_t>(cut.vertices.rows()));  // triangle that each vertex was given last
  // Triangle by triangle, so that each vertex's list comes out sorted.
  const auto for_each_own = [&](auto&& visit) {
    std::fill(last.begin(), last.end(), -1);
    for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
      for (const Index touch : touches.of(static_cast<std::size_t>(t))) {
        for (const Index vertex : cut.corners[static_cast<std::size_t>(touch_cubes[static_cast<std::size_t>(touch)])]) {
          if (std::exchange(last[static_cast<std::size_t>(vertex)], static_cast<Index>(t)) != t) visit(vertex, surface.sources[t]);
        }
      }
    }
  };
  volume.own_offsets = Indices::Zero(cut.vertices.rows() + 1);
  for_each_own([&](Index vertex, Index) { ++volume.own_offsets[vertex + 1]; });
  for (Eigen::Index v = 0; v < cut.vertices.rows(); ++v) volume.own_offsets[v + 1] += volume.own_offsets[v];
  volume.own_triangles.resize(volume.own_offsets[cut.vertices.rows()]);
  Indices next = volume.own_offsets;
  for_each_own([&](Index vertex, Index source) { volume.own_triangles[next[vertex]++] = source; });
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
      if (best >= 0) break;  // inside: none is better
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
    choose_own_cubes(surface, voxels, split, carriers);
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
