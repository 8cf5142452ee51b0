// SPDX-License-Identifier: GPL-3.0-or-later
#include "voxels.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "box_tree.hpp"
#include "followthrough/errors.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr double kMostCells = 20e6;

std::array<Eigen::Vector3d, 3> grid_corners(const PreparedSurface& surface, const Voxels& voxels, Eigen::Index triangle) {
  return {voxels.corner(surface, triangle, 0), voxels.corner(surface, triangle, 1), voxels.corner(surface, triangle, 2)};
}

// Calls visit(cell) for the cells that a triangle meets when each cell is shrunk (or grown) to the given half edge. Walks the
// columns along the axis that the triangle faces most, so a big triangle costs its area, not its bounding box's volume.
template <typename Visit>
void for_each_met_cell(const std::array<Eigen::Vector3d, 3>& corners, const VoxelGrid& grid, double half, Visit&& visit) {
  const double margin = half - 0.5;
  const Eigen::Vector3d least = corners[0].cwiseMin(corners[1]).cwiseMin(corners[2]);
  const Eigen::Vector3d most = corners[0].cwiseMax(corners[1]).cwiseMax(corners[2]);
  Eigen::Vector3i from, to;
  for (int k = 0; k < 3; ++k) {
    from[k] = std::max(floor_index(least[k] - std::max(margin, 0.0)), grid.low[k]);
    to[k] = std::min(floor_index(most[k] + std::max(margin, 0.0)), grid.low[k] + grid.size[k] - 1);
  }
  if (from == to) {
    // Most triangles of a fine mesh: wholly in one cell, well away from its sides.
    const Eigen::Vector3d centre = from.cast<double>() + Eigen::Vector3d::Constant(0.5);
    if ((centre - least).cwiseMax(most - centre).maxCoeff() < half * (1 - 1e-9)) {
      visit(from);
      return;
    }
  }
  const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
  Eigen::Index axis = 0;
  normal.cwiseAbs().maxCoeff(&axis);
  const Eigen::Index u = (axis + 1) % 3, v = (axis + 2) % 3;
  const bool flat_enough = std::abs(normal[axis]) > 1e-12;
  Eigen::Vector3i cell;
  for (cell[u] = from[u]; cell[u] <= to[u]; ++cell[u]) {
    for (cell[v] = from[v]; cell[v] <= to[v]; ++cell[v]) {
      int first = from[axis], last = to[axis];
      if (flat_enough) {
        // Height of the triangle's plane over the column.
        const double slope_u = -normal[u] / normal[axis], slope_v = -normal[v] / normal[axis];
        const double middle =
            corners[0][axis] + slope_u * (cell[u] + 0.5 - corners[0][u]) + slope_v * (cell[v] + 0.5 - corners[0][v]);
        const double spread = half * (std::abs(slope_u) + std::abs(slope_v)) + 1e-3;
        first = std::max(first, floor_index(middle - spread));
        last = std::min(last, floor_index(middle + spread));
      }
      for (cell[axis] = first; cell[axis] <= last; ++cell[axis]) {
        if (triangle_meets_cube(corners, cell.cast<double>() + Eigen::Vector3d::Constant(0.5), half)) visit(cell);
      }
    }
  }
}

// Fills the touch lists; returns the triangles that reach into no cell, because they lie in a grid plane.
std::vector<Index> find_touched(const PreparedSurface& surface, Voxels& voxels) {
  const Eigen::Index triangles = surface.triangles.rows();
  const Eigen::Index chunk = 1024;
  const Eigen::Index chunks = (triangles + chunk - 1) / chunk;
  std::vector<std::vector<std::pair<Index, Index>>> found(static_cast<std::size_t>(chunks));
  std::vector<std::vector<Index>> missed(static_cast<std::size_t>(chunks));
#pragma omp parallel for schedule(dynamic) num_threads(worthwhile_threads(triangles, 200))
  for (Eigen::Index c = 0; c < chunks; ++c) {
    auto& own = found[static_cast<std::size_t>(c)];
    for (Eigen::Index t = c * chunk; t < std::min(triangles, (c + 1) * chunk); ++t) {
      const std::size_t before = own.size();
      for_each_met_cell(grid_corners(surface, voxels, t), voxels.grid, 0.5 - kTouchDepth,
                        [&](const Eigen::Vector3i& cell) { own.emplace_back(voxels.grid.number(cell), static_cast<Index>(t)); });
      if (own.size() == before) missed[static_cast<std::size_t>(c)].push_back(static_cast<Index>(t));
    }
  }
  voxels.touch_offsets.assign(static_cast<std::size_t>(voxels.grid.count()) + 1, 0);
  for (const auto& own : found) {
    for (const auto& [cell, triangle] : own) ++voxels.touch_offsets[static_cast<std::size_t>(cell) + 1];
  }
  for (std::size_t k = 1; k < voxels.touch_offsets.size(); ++k) voxels.touch_offsets[k] += voxels.touch_offsets[k - 1];
  voxels.touch_triangles.resize(static_cast<std::size_t>(voxels.touch_offsets.back()));
  std::vector<Index> next(voxels.touch_offsets.begin(), voxels.touch_offsets.end() - 1);
  for (const auto& own : found) {
    for (const auto& [cell, triangle] : own)
      voxels.touch_triangles[static_cast<std::size_t>(next[static_cast<std::size_t>(cell)]++)] = triangle;
  }
  std::vector<Index> flat;
  for (const auto& own : missed) flat.insert(flat.end(), own.begin(), own.end());
  return flat;
}

// On a closed surface: one winding number for each group of untouched cells that hang together.
void fill_closed(const PreparedSurface& surface, const TriangleTree& tree, const std::vector<Index>& flat, Voxels& voxels) {
  const VoxelGrid& grid = voxels.grid;
  const auto count = static_cast<std::size_t>(grid.count());
  // Beside a face that lies in a grid plane one must not step from cell to cell.
  std::vector<char> barrier(count, 0);
  for (const Index t : flat) {
    for_each_met_cell(grid_corners(surface, voxels, t), grid, 0.5 + 2 * kTouchDepth,
                      [&](const Eigen::Vector3i& cell) { barrier[static_cast<std::size_t>(grid.number(cell))] = 1; });
  }
  std::vector<char> seen(count, 0);
  std::vector<Index> group;
  for (std::size_t seed = 0; seed < count; ++seed) {
    if (seen[seed] || voxels.touched(static_cast<Index>(seed))) continue;
    group.assign(1, static_cast<Index>(seed));
    seen[seed] = 1;
    for (std::size_t at = 0; at < group.size(); ++at) {
      const Eigen::Vector3i cell = grid.cell(group[at]);
      for (int axis = 0; axis < 3; ++axis) {
        for (const int side : {-1, 1}) {
          Eigen::Vector3i other = cell;
          other[axis] += side;
          if (!grid.contains(other)) continue;
          const Index number = grid.number(other);
          const auto n = static_cast<std::size_t>(number);
          if (seen[n] || voxels.touched(number) || (barrier[n] && barrier[static_cast<std::size_t>(group[at])])) continue;
          seen[n] = 1;
          group.push_back(number);
        }
      }
    }
    const Eigen::Vector3d centre = grid.from_grid(grid.cell(group[0]).cast<double>() + Eigen::Vector3d::Constant(0.5));
    if (std::abs(tree.winding_number_near(centre, 0.5)) > 0.5) {
      for (const Index cell : group) voxels.enclosed[static_cast<std::size_t>(cell)] = 1;
    }
  }
}

void fill_open(const TriangleTree& tree, Voxels& voxels) {
  const Index count = voxels.grid.count();
#pragma omp parallel for schedule(dynamic, 64) num_threads(worthwhile_threads(count, 2'000))
  for (Index cell = 0; cell < count; ++cell) {
    if (voxels.touched(cell)) continue;
    const Eigen::Vector3d centre = voxels.grid.from_grid(voxels.grid.cell(cell).cast<double>() + Eigen::Vector3d::Constant(0.5));
    voxels.enclosed[static_cast<std::size_t>(cell)] = tree.winding_number_near(centre, 0.5) > 0.5;
  }
}

void add_touches(std::vector<std::pair<Index, Index>> more, Voxels& voxels) {
  if (more.empty()) return;
  for (Index cell = 0; cell < voxels.grid.count(); ++cell) {
    for (Index row = voxels.touch_offsets[static_cast<std::size_t>(cell)];
         row < voxels.touch_offsets[static_cast<std::size_t>(cell) + 1]; ++row) {
      more.emplace_back(cell, voxels.touch_triangles[static_cast<std::size_t>(row)]);
    }
  }
  std::sort(more.begin(), more.end());
  voxels.touch_triangles.clear();
  std::fill(voxels.touch_offsets.begin(), voxels.touch_offsets.end(), 0);
  for (const auto& [cell, triangle] : more) {
    ++voxels.touch_offsets[static_cast<std::size_t>(cell) + 1];
    voxels.touch_triangles.push_back(triangle);
  }
  for (std::size_t k = 1; k < voxels.touch_offsets.size(); ++k) voxels.touch_offsets[k] += voxels.touch_offsets[k - 1];
}

// A sheet in a grid plane: move it a little to its inner side and keep the cells that it then touches.
void keep_beside_flat(const PreparedSurface& surface, const std::vector<Index>& flat, Voxels& voxels) {
  const VoxelGrid& grid = voxels.grid;
  std::vector<std::pair<Index, Index>> more;
  for (const Index t : flat) {
    const auto corners = grid_corners(surface, voxels, t);
    const Eigen::Vector3d normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    const double depth = 4 * kTouchDepth;
    std::array<Eigen::Vector3d, 3> moved = corners;
    Eigen::Vector3i step = Eigen::Vector3i::Zero();  // to the cell on the other side
    for (int axis = 0; axis < 3; ++axis) {
      double least = corners[0][axis], most = corners[0][axis];
      for (const auto& corner : corners) {
        least = std::min(least, corner[axis]);
        most = std::max(most, corner[axis]);
      }
      const double plane = std::round(0.5 * (least + most));
      if (std::abs(least - plane) > 2 * kTouchDepth || std::abs(most - plane) > 2 * kTouchDepth) continue;
      int side = normal[axis] > 0 ? -1 : 1;
      if (plane <= grid.low[axis]) side = 1;
      if (plane >= grid.low[axis] + grid.size[axis]) side = -1;
      step[axis] = -side;
      for (auto& corner : moved) corner[axis] = plane + side * depth;
    }
    for_each_met_cell(moved, grid, 0.5 - kTouchDepth, [&](const Eigen::Vector3i& cell) {
      for (int combination = 0; combination < 8; ++combination) {
        Eigen::Vector3i other = cell;
        for (int axis = 0; axis < 3; ++axis) other[axis] += (combination >> axis & 1) * step[axis];
        if (grid.contains(other) && voxels.kept[static_cast<std::size_t>(grid.number(other))]) return;
      }
      more.emplace_back(grid.number(cell), t);
    });
    for (const auto& [cell, triangle] : more) voxels.kept[static_cast<std::size_t>(cell)] = 1;
  }
  add_touches(more, voxels);
}

}  // namespace

VoxelGrid make_grid(const PreparedSurface& surface, Index cells, double cell_size) {
  Box bounds;
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    for (int k = 0; k < 3; ++k) bounds.extend(Eigen::Vector3d(surface.vertices.row(surface.triangles(t, k))));
  }
  const double longest = bounds.sizes().maxCoeff();
  VoxelGrid grid;
  grid.centre = bounds.center();
  const char* name = "cells";
  double along = cells;
  if (cell_size != 0) {
    name = "cell_size";
    if (!(cell_size > 0) || !std::isfinite(cell_size)) {
      throw InvalidInput("cell_size", "found " + std::to_string(cell_size) + ", expected a positive length");
    }
    grid.edge = cell_size;
    // A surface that sticks out by less than what counts as touching needs no further cell.
    along = std::max(1.0, std::ceil(longest / cell_size - 2 * kTouchDepth));
  } else {
    if (cells < 1) throw InvalidInput("cells", "found " + std::to_string(cells) + ", expected 1 or more");
    grid.edge = longest / cells;
  }
  const auto too_many = [&](double count) {
    return InvalidInput(name, "would make a grid of " + std::to_string(static_cast<std::int64_t>(std::min(count, 9e18))) +
                                  " cells, expected 20 million at most (use " +
                                  (cell_size != 0 ? "a larger cell_size" : "fewer cells") + ")");
  };
  const Eigen::Vector3d spans = bounds.sizes() / grid.edge;
  if (along > 1e6) throw too_many(std::max({1.0, spans[0]}) * std::max({1.0, spans[1]}) * std::max({1.0, spans[2]}));
  grid.cells = static_cast<Index>(along);
  const Eigen::Vector3d least = grid.to_grid(bounds.min()), most = grid.to_grid(bounds.max());
  double count = 1;
  for (int k = 0; k < 3; ++k) {
    const int first = std::clamp(static_cast<int>(std::floor(least[k] - 2 * kTouchDepth)), 0, grid.cells - 1);
    const int last = std::clamp(static_cast<int>(std::floor(most[k] + 2 * kTouchDepth)), 0, grid.cells - 1);
    grid.low[k] = first;
    grid.size[k] = last - first + 1;
    count *= grid.size[k];
  }
  if (count > kMostCells) throw too_many(count);
  return grid;
}

Voxels voxelize(const PreparedSurface& surface, const TriangleTree& tree, const VoxelGrid& grid) {
  Voxels voxels;
  voxels.grid = grid;
  voxels.positions.resize(surface.vertices.rows(), 3);
  for (Eigen::Index v = 0; v < surface.vertices.rows(); ++v) voxels.positions.row(v) = grid.to_grid(surface.vertices.row(v));
  const std::vector<Index> flat = find_touched(surface, voxels);
  const auto count = static_cast<std::size_t>(grid.count());
  voxels.enclosed.assign(count, 0);
  if (surface.closed) {
    fill_closed(surface, tree, flat, voxels);
  } else {
    fill_open(tree, voxels);
  }
  voxels.kept.resize(count);
  for (std::size_t cell = 0; cell < count; ++cell)
    voxels.kept[cell] = voxels.enclosed[cell] || voxels.touched(static_cast<Index>(cell));
  keep_beside_flat(surface, flat, voxels);
  return voxels;
}

bool triangle_meets_cube(const std::array<Eigen::Vector3d, 3>& corners, const Eigen::Vector3d& centre, double half) {
  const std::array<Eigen::Vector3d, 3> p = {corners[0] - centre, corners[1] - centre, corners[2] - centre};
  for (int axis = 0; axis < 3; ++axis) {
    if (std::min({p[0][axis], p[1][axis], p[2][axis]}) > half || std::max({p[0][axis], p[1][axis], p[2][axis]}) < -half)
      return false;
  }
  const std::array<Eigen::Vector3d, 3> edges = {p[1] - p[0], p[2] - p[1], p[0] - p[2]};
  const Eigen::Vector3d normal = edges[0].cross(edges[1]);
  if (std::abs(normal.dot(p[0])) > half * normal.cwiseAbs().sum()) return false;
  for (const auto& edge : edges) {
    for (int axis = 0; axis < 3; ++axis) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      // The axis is unit(axis) x edge.
      const double a = edge[u] * p[0][v] - edge[v] * p[0][u];
      const double b = edge[u] * p[1][v] - edge[v] * p[1][u];
      const double c = edge[u] * p[2][v] - edge[v] * p[2][u];
      const double reach = half * (std::abs(edge[u]) + std::abs(edge[v]));
      if (std::min({a, b, c}) > reach || std::max({a, b, c}) < -reach) return false;
    }
  }
  return true;
}

}  // namespace followthrough
