// SPDX-License-Identifier: GPL-3.0-or-later
#include "part_splitting.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include <Eigen/Dense>

#include "cell_patches.hpp"
#include "depth_lines.hpp"
#include "disjoint_sets.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr std::size_t kLatticePoints = static_cast<std::size_t>(kLinesPerCell * kLinesPerCell * kLinesPerCell);
constexpr double kTwice = 1.65;  // winding number of an overlap; at a wall inside the body it comes up to 1.5
constexpr Index kNone = -1;
constexpr Index kAmbiguous = -2;

// Everything found out about the cells on the way to the cubes. A node is a patch of a cell, a stretch's piece in a touched cell,
// or a whole untouched cell.
class PartSplitter {
 public:
  PartSplitter(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels)
      : surface_(surface),
        tree_(tree),
        voxels_(voxels),
        grid_(voxels.grid),
        stretches_(find_stretches(surface, tree, voxels.grid)) {
    number_patches();
    drop_shallow_overlaps();
    number_pieces();
  }

  SplitCubes split() {
    DisjointSets nodes(node_count_);
    join_along_stretches(nodes);
    join_at_lattice(nodes);
    join_by_sight(nodes);
    join_pieces_of_mesh(nodes);
    make_cubes(nodes);
    join_corners(nodes);
    return finish();
  }

 private:
  bool kept(Index cell) const { return voxels_.kept[static_cast<std::size_t>(cell)]; }
  std::size_t touch_begin(Index cell) const {
    return static_cast<std::size_t>(voxels_.touch_offsets[static_cast<std::size_t>(cell)]);
  }
  std::size_t touch_end(Index cell) const {
    return static_cast<std::size_t>(voxels_.touch_offsets[static_cast<std::size_t>(cell) + 1]);
  }

  // Row of the cell's touch list that holds a triangle, or the list's end.
  std::size_t touch_of(Index cell, Index triangle) const {
    const auto first = voxels_.touch_triangles.begin() + static_cast<std::ptrdiff_t>(touch_begin(cell));
    const auto last = voxels_.touch_triangles.begin() + static_cast<std::ptrdiff_t>(touch_end(cell));
    const auto found = std::lower_bound(first, last, triangle);
    return found != last && *found == triangle ? static_cast<std::size_t>(found - voxels_.touch_triangles.begin())
                                               : touch_end(cell);
  }

  Index area_rank(std::size_t touch) const {
    return ranks_[static_cast<std::size_t>(surface_.components[voxels_.touch_triangles[touch]])];
  }

  void number_patches() {
    const auto count = static_cast<std::size_t>(grid_.count());
    ordinal_.assign(count, kNone);
    for (Index cell = 0; cell < grid_.count(); ++cell) {
      if (!voxels_.touched(cell)) continue;
      ordinal_[static_cast<std::size_t>(cell)] = static_cast<Index>(touched_.size());
      touched_.push_back(cell);
    }
    touch_nodes_.resize(voxels_.touch_triangles.size());
    borders_.resize(touched_.size());
    std::vector<Index> counts(touched_.size());
#pragma omp parallel for schedule(dynamic, 32) num_threads(worthwhile_threads(std::ssize(voxels_.touch_triangles), 300))
    for (std::size_t k = 0; k < touched_.size(); ++k) {
      CellPatches patches = patches_in_cell(surface_, voxels_, touched_[k]);
      std::copy(patches.labels.begin(), patches.labels.end(),
                touch_nodes_.begin() + static_cast<std::ptrdiff_t>(touch_begin(touched_[k])));
      counts[k] = patches.count;
      borders_[k] = std::move(patches.borders);
    }
    for (std::size_t k = 0; k < touched_.size(); ++k) {
      for (std::size_t touch = touch_begin(touched_[k]); touch < touch_end(touched_[k]); ++touch) {
        touch_nodes_[touch] += static_cast<Index>(node_count_);
      }
      node_count_ += static_cast<std::size_t>(counts[k]);
    }
    cell_nodes_.assign(count, kNone);
    for (Index cell = 0; cell < grid_.count(); ++cell) {
      if (kept(cell) && !voxels_.touched(cell)) cell_nodes_[static_cast<std::size_t>(cell)] = static_cast<Index>(node_count_++);
    }
    Vector areas = Vector::Zero(surface_.component_count);
    for (Eigen::Index t = 0; t < surface_.triangles.rows(); ++t) {
      const Eigen::Vector3d a = surface_.vertices.row(surface_.triangles(t, 0));
      const Eigen::Vector3d b = surface_.vertices.row(surface_.triangles(t, 1));
      const Eigen::Vector3d c = surface_.vertices.row(surface_.triangles(t, 2));
      areas[surface_.components[t]] += (b - a).cross(c - a).norm();
    }
    std::vector<Index> order(static_cast<std::size_t>(surface_.component_count));
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<Index>(k);
    std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) { return areas[a] > areas[b]; });
    ranks_.resize(order.size());
    for (std::size_t k = 0; k < order.size(); ++k) ranks_[static_cast<std::size_t>(order[k])] = static_cast<Index>(k);
  }

  std::pair<int, int> cells_along(const Stretch& s) const {
    int first = static_cast<int>(std::floor(s.from + kTouchDepth)), last = static_cast<int>(std::floor(s.to - kTouchDepth));
    if (first > last) first = last = static_cast<int>(std::floor(0.5 * (s.from + s.to)));
    const int low = grid_.low[s.axis], high = low + grid_.size[s.axis] - 1;
    first = std::clamp(first, low, high);
    return {first, std::clamp(last, first, high)};
  }

  // Parts that overlap a little stay apart; where the overlap holds a whole cell, they are one.
  void drop_shallow_overlaps() {
    std::erase_if(stretches_, [&](const Stretch& s) {
      if (!s.overlap) return false;
      const auto [first, last] = cells_along(s);
      for (int along = first; along <= last; ++along) {
        if (cell_nodes_[static_cast<std::size_t>(cell_on(s, along))] != kNone) return false;
      }
      return true;
    });
  }

  void number_pieces() {
    first_cells_.reserve(stretches_.size());
    last_cells_.reserve(stretches_.size());
    first_pieces_.reserve(stretches_.size());
    for (const Stretch& s : stretches_) {
      const auto [first, last] = cells_along(s);
      first_cells_.push_back(first);
      last_cells_.push_back(last);
      first_pieces_.push_back(static_cast<Index>(node_count_));
      node_count_ += static_cast<std::size_t>(last - first + 1);
    }
  }

  Index cell_on(const Stretch& s, int along) const {
    Eigen::Vector3i cell;
    cell[s.axis] = along;
    const int u = (s.axis + 1) % 3, v = (s.axis + 2) % 3;
    cell[u] = grid_.low[u] + s.u / kLinesPerCell;
    cell[v] = grid_.low[v] + s.v / kLinesPerCell;
    return grid_.number(cell);
  }

  // The node of a stretch in one of its cells; kNone where that cell was not kept.
  Index node_on(std::size_t stretch, int along) const {
    const Index cell = cell_on(stretches_[stretch], along);
    if (!kept(cell)) return kNone;
    const Index whole = cell_nodes_[static_cast<std::size_t>(cell)];
    return whole != kNone ? whole : first_pieces_[stretch] + along - first_cells_[stretch];
  }

  // Where a line goes in and out, it meets patches.
  void join_along_stretches(DisjointSets& nodes) const {
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
      const Stretch& s = stretches_[k];
      for (const auto& [along, triangle] : {std::pair(first_cells_[k], s.enter), std::pair(last_cells_[k], s.exit)}) {
        if (triangle == kNone) continue;
        const Index cell = cell_on(s, along);
        const std::size_t touch = touch_of(cell, triangle);
        if (touch != touch_end(cell)) nodes.join(touch_nodes_[touch], node_on(k, along));
      }
    }
  }

  // Lines of three directions meet in the lattice's points: their stretches there are the same material, unless the body overlaps
  // itself.
  void join_at_lattice(DisjointSets& nodes) {
    for (auto& at : lattice_) at.assign(touched_.size() * kLatticePoints, kNone);
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
      const Stretch& s = stretches_[k];
      const int u = (s.axis + 1) % 3, v = (s.axis + 2) % 3;
      auto& at = lattice_[static_cast<std::size_t>(s.axis)];
      for (int along = first_cells_[k]; along <= last_cells_[k]; ++along) {
        const Index ordinal = ordinal_[static_cast<std::size_t>(cell_on(s, along))];
        if (ordinal == kNone) continue;
        for (int row = 0; row < kLinesPerCell; ++row) {
          const double place = along + lattice_place(s.axis, row);
          if (place < s.from || place > s.to) continue;
          std::array<int, 3> local{};
          local[static_cast<std::size_t>(s.axis)] = row;
          local[static_cast<std::size_t>(u)] = s.u % kLinesPerCell;
          local[static_cast<std::size_t>(v)] = s.v % kLinesPerCell;
          Index& held = at[static_cast<std::size_t>(ordinal) * kLatticePoints + point_index(local)];
          if (s.overlap) {
            held = kAmbiguous;
          } else if (held == kNone) {
            held = static_cast<Index>(k);
          } else if (held != kAmbiguous && stretches_[static_cast<std::size_t>(held)].shell != s.shell) {
            nodes.join(node_on(static_cast<std::size_t>(held), along), node_on(k, along));  // pieces of the mesh that overlap
          } else {
            held = kAmbiguous;
          }
        }
      }
    }
    for (std::size_t p = 0; p < lattice_[0].size(); ++p) {
      const Eigen::Vector3i cell = grid_.cell(touched_[p / kLatticePoints]);
      Index together = kNone;
      for (int axis = 0; axis < 3; ++axis) {
        Index& held = lattice_[static_cast<std::size_t>(axis)][p];
        if (held < 0) continue;
        const Index node = node_on(static_cast<std::size_t>(held), cell[axis]);
        if (together == kNone) together = node;
        const bool clear = lattice_[0][p] != kAmbiguous && lattice_[1][p] != kAmbiguous && lattice_[2][p] != kAmbiguous;
        if (clear) nodes.join(together, node);
      }
    }
  }

  static std::size_t point_index(const std::array<int, 3>& local) {
    return static_cast<std::size_t>((local[0] * kLinesPerCell + local[1]) * kLinesPerCell + local[2]);
  }

  // What no line told: patches that see each other, or a point of the lattice, through material.
  void join_by_sight(DisjointSets& nodes) const {
#pragma omp parallel for schedule(dynamic, 8) num_threads(worthwhile_threads(std::ssize(touched_), 5'000))
    for (std::size_t k = 0; k < touched_.size(); ++k) look_around(k, nodes);
  }

  void look_around(std::size_t ordinal, DisjointSets& nodes) const {
    const Index cell = touched_[ordinal];
    const Eigen::Vector3i at = grid_.cell(cell);
    // Points of the lattice in material, with their nodes.
    std::vector<std::pair<Index, Eigen::Vector3d>> lattice;
    for (std::size_t p = 0; p < kLatticePoints; ++p) {
      Index node = kNone;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        const Index held = lattice_[axis][ordinal * kLatticePoints + p];
        if (held == kAmbiguous) {
          node = kNone;
          break;
        }
        if (held >= 0 && node == kNone) node = node_on(static_cast<std::size_t>(held), at[static_cast<Eigen::Index>(axis)]);
      }
      if (node == kNone) continue;
      const auto index = static_cast<int>(p);
      const std::array<int, 3> local = {index / (kLinesPerCell * kLinesPerCell), index / kLinesPerCell % kLinesPerCell,
                                        index % kLinesPerCell};
      Eigen::Vector3d place = at.cast<double>();
      for (int axis = 0; axis < 3; ++axis) place[axis] += lattice_place(axis, local[static_cast<std::size_t>(axis)]);
      lattice.emplace_back(node, place);
    }
    bool several = false;
    const Index first = nodes.find(touch_nodes_[touch_begin(cell)]);
    for (std::size_t touch = touch_begin(cell); touch < touch_end(cell); ++touch)
      several |= nodes.find(touch_nodes_[touch]) != first;
    for (const auto& [node, place] : lattice) several |= nodes.find(node) != first;
    if (!several) return;

    const CellView view(surface_, voxels_, cell);
    struct Below {
      std::size_t triangle;
      Eigen::Vector3d point;
      bool in_overlap;  // with another part of the body
    };
    std::map<Index, std::vector<Below>> below;  // by patch: a few points just inside it
    for (std::size_t touch = touch_begin(cell); touch < touch_end(cell); ++touch) {
      auto& points = below[touch_nodes_[touch]];
      Eigen::Vector3d point;
      if (points.size() < 8 && view.point_below(touch - touch_begin(cell), point)) {
        points.push_back({touch - touch_begin(cell), point, tree_.winding_number_near(grid_.from_grid(point), kTwice) > kTwice});
      }
    }
    for (const auto& [patch, points] : below) {
      for (const auto& from : points) {
        for (const auto& [node, place] : lattice) {
          if (nodes.find(node) != nodes.find(patch) && !from.in_overlap && view.sees(from.point, place)) nodes.join(node, patch);
        }
      }
    }
    if (below.size() > 32) return;  // a thicket: hair, leaves
    for (auto a = below.begin(); a != below.end(); ++a) {
      for (auto b = std::next(a); b != below.end(); ++b) {
        if (nodes.find(a->first) == nodes.find(b->first)) continue;
        bool seen = false;
        for (const auto& from : a->second) {
          for (const auto& to : b->second) seen = seen || (!from.in_overlap && !to.in_overlap && view.sees(from.point, to.point));
        }
        if (seen) nodes.join(a->first, b->first);
      }
    }
    // Patches that lie in another part, because the two overlap: out of the overlap to their own material.
    for (const auto& [patch, points] : below) {
      bool found = false;
      for (const auto& [node, place] : lattice) found = found || nodes.find(node) == nodes.find(patch);
      for (const auto& from : points) {
        for (const auto& [node, place] : lattice) {
          if (found || !from.in_overlap || !view.sees_out_of_overlap(from.triangle, from.point, place)) continue;
          nodes.join(node, patch);
          found = true;
        }
      }
    }
  }

  // Pieces of the mesh that overlap nothing: to the nearest larger one.
  void join_pieces_of_mesh(DisjointSets& nodes) {
    if (surface_.component_count < 2) return;
    for (std::size_t k = 0; k < touched_.size(); ++k) {
      const Index cell = touched_[k];
      struct Group {
        Index largest = std::numeric_limits<Index>::max();
        std::vector<std::size_t> touches;  // of the largest piece of the mesh in it
      };
      std::map<Index, Group> groups;
      for (std::size_t touch = touch_begin(cell); touch < touch_end(cell); ++touch) {
        Group& group = groups[nodes.find(touch_nodes_[touch])];
        if (area_rank(touch) < group.largest) group = {area_rank(touch), {}};
        if (area_rank(touch) == group.largest && group.touches.size() < 8) group.touches.push_back(touch);
      }
      const CellView view(surface_, voxels_, cell);
      for (const auto& [root, group] : groups) {
        if (group.largest == 0) continue;
        Eigen::Vector3d from;
        for (const std::size_t touch : group.touches) {
          if (view.point_below(touch - touch_begin(cell), from)) join_to_host(nodes, cell, touch, grid_.from_grid(from));
        }
      }
    }
  }

  // Joins what carries a triangle to what carries the nearest one of a larger piece of the mesh.
  void join_to_host(DisjointSets& nodes, Index cell, std::size_t touch, const Eigen::Vector3d& point) {
    const auto closest = [&](Index t) {
      return closest_on_triangle(point, surface_.vertices.row(surface_.triangles(t, 0)),
                                 surface_.vertices.row(surface_.triangles(t, 1)), surface_.vertices.row(surface_.triangles(t, 2)));
    };
    const Eigen::Vector3d reach = Eigen::Vector3d::Constant(grid_.edge);
    Index host = kNone;
    double nearest = grid_.edge * grid_.edge;
    tree_.boxes().overlapping(Box(point - reach, point + reach), [&](Index t) {
      if (ranks_[static_cast<std::size_t>(surface_.components[t])] >= area_rank(touch)) return;
      const double distance = closest(t).squared_distance;
      if (distance < nearest || (distance == nearest && host != kNone && t < host)) {
        nearest = distance;
        host = t;
      }
    });
    if (host == kNone) return;
    const std::size_t here = touch_of(cell, host);
    if (here != touch_end(cell)) {
      nodes.join(touch_nodes_[touch], touch_nodes_[here]);
      return;
    }
    const ClosestPoint on = closest(host);
    Eigen::Vector3d place = Eigen::Vector3d::Zero();
    for (int k = 0; k < 3; ++k) place += on.barycentric[k] * surface_.vertices.row(surface_.triangles(host, k)).transpose();
    const Eigen::Vector3i other = grid_.to_grid(place).array().floor().cast<int>();
    if (!grid_.contains(other) || (other - grid_.cell(cell)).cwiseAbs().maxCoeff() > 1) return;
    const std::size_t there = touch_of(grid_.number(other), host);
    if (there != touch_end(grid_.number(other))) neighbour_joins_.emplace_back(touch, there);
  }

  // One cube for each set of nodes with a patch in it, and one for each untouched cell.
  void make_cubes(DisjointSets& nodes) {
    cube_of_node_.assign(node_count_, kNone);
    touch_cubes_.resize(touch_nodes_.size());
    for (Index cell = 0; cell < grid_.count(); ++cell) {
      const Index whole = cell_nodes_[static_cast<std::size_t>(cell)];
      if (whole != kNone) {
        cube_of_node_[static_cast<std::size_t>(whole)] = static_cast<Index>(cubes_.size());
        cubes_.push_back(cell);
      }
      for (std::size_t touch = touch_begin(cell); touch < touch_end(cell); ++touch) {
        Index& cube = cube_of_node_[static_cast<std::size_t>(nodes.find(touch_nodes_[touch]))];
        if (cube == kNone) {
          cube = static_cast<Index>(cubes_.size());
          cubes_.push_back(cell);
        }
        touch_cubes_[touch] = cube;
      }
    }
  }

  void join_cubes(DisjointSets& corners, Index cube, Index other) const {
    const Eigen::Vector3i step =
        grid_.cell(cubes_[static_cast<std::size_t>(other)]) - grid_.cell(cubes_[static_cast<std::size_t>(cube)]);
    for (int k = 0; k < 8; ++k) {
      const Eigen::Vector3i there = cube_corner(k) - step;
      if (there.minCoeff() < 0 || there.maxCoeff() > 1) continue;
      corners.join(8 * cube + k, 8 * other + (there[0] << 2 | there[1] << 1 | there[2]));
    }
  }

  // The same triangle in two cells.
  void join_by_triangles(DisjointSets& corners, Index cell, Index other) const {
    std::size_t a = touch_begin(cell), b = touch_begin(other);
    Index last_a = kNone, last_b = kNone;
    while (a < touch_end(cell) && b < touch_end(other)) {
      const Index ta = voxels_.touch_triangles[a], tb = voxels_.touch_triangles[b];
      if (ta == tb && (touch_cubes_[a] != last_a || touch_cubes_[b] != last_b)) {
        last_a = touch_cubes_[a];
        last_b = touch_cubes_[b];
        join_cubes(corners, last_a, last_b);
      }
      a += ta <= tb;
      b += tb <= ta;
    }
  }

  // Different triangles at one edge, which lies between the two cells.
  void join_by_borders(DisjointSets& corners, std::size_t ordinal, std::size_t other) const {
    auto a = borders_[ordinal].begin(), b = borders_[other].begin();
    while (a != borders_[ordinal].end() && b != borders_[other].end()) {
      const auto key_a = std::pair(a->low, a->high), key_b = std::pair(b->low, b->high);
      if (key_a == key_b) join_cubes(corners, touch_cubes_[a->touch], touch_cubes_[b->touch]);
      a += key_a <= key_b;
      b += key_b <= key_a;
    }
  }

  void join_corners(DisjointSets& nodes) {
    DisjointSets corners(8 * cubes_.size());
    for (std::size_t k = 0; k < touched_.size(); ++k) {
      const Index cell = touched_[k];
      for (int direction = 14; direction < 27; ++direction) {
        const Eigen::Vector3i next =
            grid_.cell(cell) + Eigen::Vector3i(direction / 9 - 1, direction / 3 % 3 - 1, direction % 3 - 1);
        if (!grid_.contains(next) || !voxels_.touched(grid_.number(next))) continue;
        join_by_triangles(corners, cell, grid_.number(next));
        join_by_borders(corners, k, static_cast<std::size_t>(ordinal_[static_cast<std::size_t>(grid_.number(next))]));
      }
    }
    // A line that passes from cell to cell through material.
    for (std::size_t k = 0; k < stretches_.size(); ++k) {
      Index before = kNone;
      for (int along = first_cells_[k]; along <= last_cells_[k]; ++along) {
        const Index node = node_on(k, along);
        const Index cube = node == kNone ? kNone : cube_of_node_[static_cast<std::size_t>(nodes.find(node))];
        if (before != kNone && cube != kNone) join_cubes(corners, before, cube);
        before = cube;
      }
    }
    for (const auto& join : neighbour_joins_) join_cubes(corners, touch_cubes_[join.first], touch_cubes_[join.second]);
    for (std::size_t cube = 0; cube < cubes_.size(); ++cube) {
      auto& own = nodes_.emplace_back();
      for (int k = 0; k < 8; ++k) own[static_cast<std::size_t>(k)] = corners.find(static_cast<Index>(8 * cube) + k);
    }
  }

  // Copies of a cell that came to share all corners are one cube.
  SplitCubes finish() const {
    SplitCubes result;
    std::vector<Index> final_cube(cubes_.size());
    std::size_t first_of_cell = 0;
    for (std::size_t cube = 0; cube < cubes_.size(); ++cube) {
      if (cube > 0 && cubes_[cube] != cubes_[cube - 1]) first_of_cell = result.cubes.cells.size();
      Index same = kNone;
      for (std::size_t other = first_of_cell; other < result.cubes.cells.size(); ++other) {
        if (result.cubes.nodes[other] == nodes_[cube]) same = static_cast<Index>(other);
      }
      if (same == kNone) {
        same = static_cast<Index>(result.cubes.cells.size());
        result.cubes.cells.push_back(cubes_[cube]);
        result.cubes.nodes.push_back(nodes_[cube]);
      }
      final_cube[cube] = same;
    }
    for (const Index cube : touch_cubes_) result.touch_cubes.push_back(final_cube[static_cast<std::size_t>(cube)]);
    return result;
  }

  const PreparedSurface& surface_;
  const TriangleTree& tree_;
  const Voxels& voxels_;
  const VoxelGrid& grid_;
  std::vector<Stretch> stretches_;
  std::vector<int> first_cells_, last_cells_;     // of each stretch, along its axis
  std::vector<Index> first_pieces_;               // node of each stretch's first cell
  std::vector<Index> touched_;                    // cells with triangles
  std::vector<Index> ordinal_;                    // place of each cell in `touched_`
  std::vector<std::vector<BorderEdge>> borders_;  // of each touched cell
  std::vector<Index> touch_nodes_;                // node of each row of the touch lists
  std::vector<Index> cell_nodes_;                 // node of each kept cell without triangles
  std::vector<Index> ranks_;                      // of each piece of the mesh by area, the largest first
  std::array<std::vector<Index>, 3> lattice_;     // by axis: the stretch at each point of the touched cells
  std::size_t node_count_ = 0;
  std::vector<Index> cubes_;         // cell of each cube
  std::vector<Index> cube_of_node_;  // by the root of a set of nodes
  std::vector<Index> touch_cubes_;
  std::vector<std::pair<std::size_t, std::size_t>> neighbour_joins_;  // touches whose cubes share their corners
  std::vector<std::array<Index, 8>> nodes_;
};

}  // namespace

SplitCubes split_parts(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels) {
  return PartSplitter(surface, tree, voxels).split();
}

}  // namespace followthrough
