// SPDX-License-Identifier: GPL-3.0-or-later
#include "depth_lines.hpp"
#include "worthwhile_threads.hpp"

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

namespace followthrough {
namespace {

struct Crossing {
  Index line;
  double depth;
  Index triangle;
  bool outward;  // the line leaves the material, going up the axis
};

// Side of the line from a to b on which the point lies. The same for both triangles of an edge, so that a line never slips between
// them.
bool left_of(const Eigen::Vector2d& a, const Eigen::Vector2d& b, bool in_order, const Eigen::Vector2d& p) {
  const Eigen::Vector2d& low = in_order ? a : b;
  const Eigen::Vector2d& high = in_order ? b : a;
  const double side = (high[0] - low[0]) * (p[1] - low[1]) - (high[1] - low[1]) * (p[0] - low[0]);
  return (side >= 0) == in_order;
}

std::pair<int, int> lattice_rows(int axis, double least, double most, int low, int size) {
  const double offset = lattice_place(axis, 0) * kLinesPerCell;
  const int first = static_cast<int>(std::ceil((least - low) * kLinesPerCell - offset));
  const int last = static_cast<int>(std::floor((most - low) * kLinesPerCell - offset));
  return {std::max(first, 0), std::min(last, size * kLinesPerCell - 1)};
}

double row_place(int axis, int row, int low) { return low + row / kLinesPerCell + lattice_place(axis, row % kLinesPerCell); }

std::vector<Crossing> find_crossings(const PreparedSurface& surface, const VoxelGrid& grid, int axis) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  std::vector<Crossing> crossings;
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    std::array<Eigen::Vector3d, 3> x;
    std::array<Eigen::Vector2d, 3> flat;
    Eigen::Vector2d least, most;
    for (std::size_t k = 0; k < 3; ++k) {
      x[k] = grid.to_grid(surface.vertices.row(surface.triangles(t, static_cast<Eigen::Index>(k))));
      flat[k] = {x[k][u], x[k][v]};
      least = k == 0 ? flat[k] : Eigen::Vector2d(least.cwiseMin(flat[k]));
      most = k == 0 ? flat[k] : Eigen::Vector2d(most.cwiseMax(flat[k]));
    }
    const auto [first_u, last_u] = lattice_rows(u, least[0], most[0], grid.low[u], grid.size[u]);
    const auto [first_v, last_v] = lattice_rows(v, least[1], most[1], grid.low[v], grid.size[v]);
    for (int row_u = first_u; row_u <= last_u; ++row_u) {
      for (int row_v = first_v; row_v <= last_v; ++row_v) {
        const Eigen::Vector2d p(row_place(u, row_u, grid.low[u]), row_place(v, row_v, grid.low[v]));
        std::array<bool, 3> left{};
        for (std::size_t k = 0; k < 3; ++k) {
          const std::size_t next = (k + 1) % 3;
          left[k] = left_of(
              flat[k], flat[next],
              surface.triangles(t, static_cast<Eigen::Index>(k)) < surface.triangles(t, static_cast<Eigen::Index>(next)), p);
        }
        if (left[0] != left[1] || left[1] != left[2]) continue;
        const Eigen::Vector3d normal = (x[1] - x[0]).cross(x[2] - x[0]);
        if (normal[axis] == 0) continue;
        double depth = x[0][axis] - (normal[u] * (p[0] - x[0][u]) + normal[v] * (p[1] - x[0][v])) / normal[axis];
        depth = std::clamp(depth, std::min({x[0][axis], x[1][axis], x[2][axis]}), std::max({x[0][axis], x[1][axis], x[2][axis]}));
        crossings.push_back({row_u * grid.size[v] * kLinesPerCell + row_v, depth, static_cast<Index>(t), left[0]});
      }
    }
  }
  std::sort(crossings.begin(), crossings.end(), [](const Crossing& a, const Crossing& b) {
    return std::tie(a.line, a.depth, a.triangle) < std::tie(b.line, b.depth, b.triangle);
  });
  return crossings;
}

// On an open surface: whether the line is outside between a crossing and the next one.
std::vector<char> outside_after(const std::vector<Crossing>& crossings, const TriangleTree& tree, const VoxelGrid& grid, int axis) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  std::vector<char> outside(crossings.size(), 0);
#pragma omp parallel for schedule(dynamic, 256) num_threads(worthwhile_threads(std::ssize(crossings), 2'000))
  for (std::size_t k = 0; k < crossings.size(); ++k) {
    if (k + 1 == crossings.size() || crossings[k + 1].line != crossings[k].line) {
      outside[k] = 1;
      continue;
    }
    const double gap = crossings[k + 1].depth - crossings[k].depth;
    if (gap < 1e-6) continue;
    Eigen::Vector3d middle;
    middle[axis] = crossings[k].depth + gap / 2;
    middle[u] = row_place(u, crossings[k].line / (grid.size[v] * kLinesPerCell), grid.low[u]);
    middle[v] = row_place(v, crossings[k].line % (grid.size[v] * kLinesPerCell), grid.low[v]);
    outside[k] = !(tree.winding_number_near(grid.from_grid(middle), 0.5) > 0.5);
  }
  return outside;
}

}  // namespace

std::vector<Stretch> find_stretches(const PreparedSurface& surface, const TriangleTree& tree, const VoxelGrid& grid) {
  std::vector<Stretch> stretches;
  for (int axis = 0; axis < 3; ++axis) {
    const int rows_v = grid.size[(axis + 2) % 3] * kLinesPerCell;
    const std::vector<Crossing> crossings = find_crossings(surface, grid, axis);
    std::vector<char> outside(crossings.size(), 0);
    if (!surface.closed) outside = outside_after(crossings, tree, grid, axis);
    struct Inside {
      int level = 0;    // how often the line is inside this piece of the mesh
      double from = 0;  // since where
      Index enter = -1;
    };
    std::map<Index, Inside> inside;
    for (std::size_t k = 0; k < crossings.size(); ++k) {
      const Crossing& crossing = crossings[k];
      if (k == 0 || crossings[k - 1].line != crossing.line) inside.clear();
      const Index shell = surface.shells[crossing.triangle];
      const Crossings way = surface.shell_crossings[static_cast<std::size_t>(shell)];
      Inside& here = inside[shell];
      int level = here.level + (crossing.outward ? -1 : 1);
      if (way == Crossings::kCountInside) level = std::max(level, 0);
      if (way == Crossings::kAskEverywhere) level = outside[k] ? 0 : 1;
      if (level != here.level) {
        const bool deeper = std::abs(level) > std::abs(here.level);
        if (here.level != 0) {
          stretches.push_back({axis, crossing.line / rows_v, crossing.line % rows_v, here.from, crossing.depth, here.enter,
                               deeper ? -1 : crossing.triangle, shell, std::abs(here.level) > 1});
        }
        here = {level, crossing.depth, deeper ? crossing.triangle : -1};
      }
      if (!outside[k]) continue;
      for (auto entry = inside.begin(); entry != inside.end();) {
        const bool counted = surface.shell_crossings[static_cast<std::size_t>(entry->first)] == Crossings::kCount;
        entry = counted ? std::next(entry) : inside.erase(entry);
      }
    }
  }
  return stretches;
}

}  // namespace followthrough
