// SPDX-License-Identifier: GPL-3.0-or-later
#include "depth_lines.hpp"
#include "worthwhile_threads.hpp"

#include <algorithm>
#include <cmath>
#include <span>

#include "bucket_sort.hpp"

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

// First and last row of the lattice between two places; first > last where there is none.
std::pair<int, int> lattice_rows(int axis, double least, double most, int low, int size) {
  const double offset = lattice_place(axis, 0) * kLinesPerCell;
  const int first = -floor_index(offset - (least - low) * kLinesPerCell);
  const int last = floor_index((most - low) * kLinesPerCell - offset);
  return {std::max(first, 0), std::min(last, size * kLinesPerCell - 1)};
}

double row_place(int axis, int row, int low) { return low + row / kLinesPerCell + lattice_place(axis, row % kLinesPerCell); }

// By axis; sorted by line, depth and triangle.
std::array<std::vector<Crossing>, 3> find_crossings(const PreparedSurface& surface, const Voxels& voxels) {
  const VoxelGrid& grid = voxels.grid;
  std::array<std::vector<Crossing>, 3> crossings;
  for (Eigen::Index t = 0; t < surface.triangles.rows(); ++t) {
    const std::array<Eigen::Vector3d, 3> x = {voxels.corner(surface, t, 0), voxels.corner(surface, t, 1),
                                              voxels.corner(surface, t, 2)};
    const Eigen::Vector3d least = x[0].cwiseMin(x[1]).cwiseMin(x[2]), most = x[0].cwiseMax(x[1]).cwiseMax(x[2]);
    std::array<std::pair<int, int>, 3> rows;
    for (int a = 0; a < 3; ++a) rows[static_cast<std::size_t>(a)] = lattice_rows(a, least[a], most[a], grid.low[a], grid.size[a]);
    for (int axis = 0; axis < 3; ++axis) {
      const int u = (axis + 1) % 3, v = (axis + 2) % 3;
      const auto [first_u, last_u] = rows[static_cast<std::size_t>(u)];
      const auto [first_v, last_v] = rows[static_cast<std::size_t>(v)];
      for (int row_u = first_u; row_u <= last_u; ++row_u) {
        for (int row_v = first_v; row_v <= last_v; ++row_v) {
          const Eigen::Vector2d p(row_place(u, row_u, grid.low[u]), row_place(v, row_v, grid.low[v]));
          std::array<bool, 3> left{};
          for (std::size_t k = 0; k < 3; ++k) {
            const std::size_t next = (k + 1) % 3;
            left[k] = left_of(
                {x[k][u], x[k][v]}, {x[next][u], x[next][v]},
                surface.triangles(t, static_cast<Eigen::Index>(k)) < surface.triangles(t, static_cast<Eigen::Index>(next)), p);
          }
          if (left[0] != left[1] || left[1] != left[2]) continue;
          const Eigen::Vector3d normal = (x[1] - x[0]).cross(x[2] - x[0]);
          if (normal[axis] == 0) continue;
          double depth = x[0][axis] - (normal[u] * (p[0] - x[0][u]) + normal[v] * (p[1] - x[0][v])) / normal[axis];
          depth = std::clamp(depth, least[axis], most[axis]);
          crossings[static_cast<std::size_t>(axis)].push_back(
              {row_u * grid.size[v] * kLinesPerCell + row_v, depth, static_cast<Index>(t), left[0]});
        }
      }
    }
  }
  for (int axis = 0; axis < 3; ++axis) {
    auto& own = crossings[static_cast<std::size_t>(axis)];
    const auto lines = static_cast<std::size_t>(grid.size[(axis + 1) % 3]) * static_cast<std::size_t>(grid.size[(axis + 2) % 3]) *
                       static_cast<std::size_t>(kLinesPerCell * kLinesPerCell);
    own = bucket_sorted(
        own, lines, [](const Crossing& crossing) { return crossing.line; },
        [](const Crossing& a, const Crossing& b) { return a.depth < b.depth; });  // triangles are in order already
  }
  return crossings;
}

// Follows the lines of one axis through the surface.
class LineFollower {
 public:
  LineFollower(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels, int axis)
      : surface_(surface),
        tree_(tree),
        voxels_(voxels),
        grid_(voxels.grid),
        axis_(axis),
        rows_v_(voxels.grid.size[(axis + 2) % 3] * kLinesPerCell) {}

  // Adds the stretches of one line with all its crossings.
  void follow(std::span<const Crossing> crossings, std::vector<Stretch>& stretches) {
    inside_.clear();
    for (std::size_t k = 0; k < crossings.size(); ++k) {
      const Crossing& crossing = crossings[k];
      const Index shell = surface_.shells[crossing.triangle];
      const Crossings way = surface_.shell_crossings[static_cast<std::size_t>(shell)];
      Inside& here = inside(shell);
      int level = here.level + (crossing.outward ? -1 : 1);
      if (way == Crossings::kCountInside) level = std::max(level, 0);
      const bool outside = way == Crossings::kAskEverywhere && outside_after(crossings, k);
      if (way == Crossings::kAskEverywhere) level = outside ? 0 : 1;
      if (level != here.level) {
        const bool deeper = std::abs(level) > std::abs(here.level);
        if (here.level != 0) {
          stretches.push_back({axis_, crossing.line / rows_v_, crossing.line % rows_v_, here.from, crossing.depth, here.enter,
                               deeper ? -1 : crossing.triangle, shell, std::abs(here.level) > 1});
        }
        here = {shell, level, crossing.depth, deeper ? crossing.triangle : -1};
      }
      // Through a hole the line may have come out of shells that are not closed.
      const auto by_hole = [&](const Inside& other) {
        return other.level != 0 && surface_.shell_crossings[static_cast<std::size_t>(other.shell)] != Crossings::kCount;
      };
      if (surface_.closed || std::none_of(inside_.begin(), inside_.end(), by_hole)) continue;
      if (outside || outside_after(crossings, k)) std::erase_if(inside_, by_hole);
    }
  }

 private:
  struct Inside {
    Index shell;
    int level = 0;    // how often the line is inside this piece of the mesh
    double from = 0;  // since where
    Index enter = -1;
  };

  Inside& inside(Index shell) {
    for (Inside& known : inside_) {
      if (known.shell == shell) return known;
    }
    return inside_.emplace_back(Inside{shell});
  }

  // Whether the line is outside between a crossing and the next one.
  bool outside_after(std::span<const Crossing> crossings, std::size_t k) const {
    if (surface_.closed) return false;
    if (k + 1 == crossings.size()) return true;
    const double gap = crossings[k + 1].depth - crossings[k].depth;
    if (gap < 1e-6) return false;
    const int u = (axis_ + 1) % 3, v = (axis_ + 2) % 3;
    Eigen::Vector3d middle;
    middle[axis_] = crossings[k].depth + gap / 2;
    middle[u] = row_place(u, crossings[k].line / rows_v_, grid_.low[u]);
    middle[v] = row_place(v, crossings[k].line % rows_v_, grid_.low[v]);
    // A cell without a triangle was asked about already.
    const Eigen::Vector3i cell(floor_index(middle[0]), floor_index(middle[1]), floor_index(middle[2]));
    const Index number = grid_.contains(cell) ? grid_.number(cell) : -1;
    if (number >= 0 && !voxels_.touched(number)) return !voxels_.kept[static_cast<std::size_t>(number)];
    return !(tree_.winding_number_near(grid_.from_grid(middle), 0.5) > 0.5);
  }

  const PreparedSurface& surface_;
  const TriangleTree& tree_;
  const Voxels& voxels_;
  const VoxelGrid& grid_;
  int axis_, rows_v_;
  std::vector<Inside> inside_;
};

}  // namespace

std::vector<Stretch> find_stretches(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels) {
  const auto crossings = find_crossings(surface, voxels);
  std::vector<Stretch> stretches;
  for (int axis = 0; axis < 3; ++axis) {
    const std::span<const Crossing> all(crossings[static_cast<std::size_t>(axis)]);
    std::vector<std::size_t> starts;  // of the lines
    for (std::size_t k = 0; k < all.size(); ++k) {
      if (k == 0 || all[k].line != all[k - 1].line) starts.push_back(k);
    }
    starts.push_back(all.size());
    const auto lines = std::ssize(starts) - 1;
    constexpr std::ptrdiff_t chunk = 128;
    const std::ptrdiff_t chunks = (lines + chunk - 1) / chunk;
    std::vector<std::vector<Stretch>> found(static_cast<std::size_t>(chunks));
    const double line_cost = surface.closed ? 50 : 1'000;  // ns
#pragma omp parallel for schedule(dynamic) num_threads(worthwhile_threads(lines, line_cost))
    for (std::ptrdiff_t c = 0; c < chunks; ++c) {
      LineFollower follower(surface, tree, voxels, axis);
      for (std::ptrdiff_t line = c * chunk; line < std::min(lines, (c + 1) * chunk); ++line) {
        const std::size_t first = starts[static_cast<std::size_t>(line)], last = starts[static_cast<std::size_t>(line) + 1];
        follower.follow(all.subspan(first, last - first), found[static_cast<std::size_t>(c)]);
      }
    }
    for (const auto& own : found) stretches.insert(stretches.end(), own.begin(), own.end());
  }
  return stretches;
}

}  // namespace followthrough
