// SPDX-License-Identifier: GPL-3.0-or-later
#include "part_splitting.hpp"

#include <array>

#include "disjoint_sets.hpp"
#include "host_joins.hpp"
#include "material_joins.hpp"
#include "part_nodes.hpp"

namespace followthrough {
namespace {

constexpr Index kNone = PartNodes::kNone;

// From sets of nodes to cubes, and to the corners that cubes of neighbouring cells share.
class PartCubes {
 public:
  PartCubes(const PartNodes& parts, DisjointSets& nodes, NeighbourJoins neighbour_joins)
      : parts_(parts), neighbour_joins_(std::move(neighbour_joins)) {
    make_cubes(nodes);
    join_corners(nodes);
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

 private:
  // One cube for each set of nodes with a patch in it, and one for each untouched cell.
  void make_cubes(DisjointSets& nodes) {
    cube_of_node_.assign(parts_.count, kNone);
    touch_cubes_.resize(parts_.touch_nodes.size());
    for (Index cell = 0; cell < parts_.grid.count(); ++cell) {
      const Index whole = parts_.cell_nodes[static_cast<std::size_t>(cell)];
      if (whole != kNone) {
        cube_of_node_[static_cast<std::size_t>(whole)] = static_cast<Index>(cubes_.size());
        cubes_.push_back(cell);
      }
      for (std::size_t touch = parts_.touch_begin(cell); touch < parts_.touch_end(cell); ++touch) {
        Index& cube = cube_of_node_[static_cast<std::size_t>(nodes.find(parts_.touch_nodes[touch]))];
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
        parts_.grid.cell(cubes_[static_cast<std::size_t>(other)]) - parts_.grid.cell(cubes_[static_cast<std::size_t>(cube)]);
    for (int k = 0; k < 8; ++k) {
      const Eigen::Vector3i there = cube_corner(k) - step;
      if (there.minCoeff() < 0 || there.maxCoeff() > 1) continue;
      corners.join(8 * cube + k, 8 * other + (there[0] << 2 | there[1] << 1 | there[2]));
    }
  }

  // The same triangle in two cells.
  void join_by_triangles(DisjointSets& corners, Index cell, Index other) const {
    std::size_t a = parts_.touch_begin(cell), b = parts_.touch_begin(other);
    Index last_a = kNone, last_b = kNone;
    while (a < parts_.touch_end(cell) && b < parts_.touch_end(other)) {
      const Index ta = parts_.voxels.touch_triangles[a], tb = parts_.voxels.touch_triangles[b];
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
    auto a = parts_.borders[ordinal].begin(), b = parts_.borders[other].begin();
    while (a != parts_.borders[ordinal].end() && b != parts_.borders[other].end()) {
      const Index key_a = a->element, key_b = b->element;
      if (key_a == key_b) join_cubes(corners, touch_cubes_[a->touch], touch_cubes_[b->touch]);
      a += key_a <= key_b;
      b += key_b <= key_a;
    }
  }

  void join_corners(DisjointSets& nodes) {
    DisjointSets corners(8 * cubes_.size());
    for (std::size_t k = 0; k < parts_.touched.size(); ++k) {
      const Index cell = parts_.touched[k];
      for (int direction = 14; direction < 27; ++direction) {
        const Eigen::Vector3i next =
            parts_.grid.cell(cell) + Eigen::Vector3i(direction / 9 - 1, direction / 3 % 3 - 1, direction % 3 - 1);
        if (!parts_.grid.contains(next) || !parts_.voxels.touched(parts_.grid.number(next))) continue;
        join_by_triangles(corners, cell, parts_.grid.number(next));
        join_by_borders(corners, k, static_cast<std::size_t>(parts_.ordinal[static_cast<std::size_t>(parts_.grid.number(next))]));
      }
    }
    // A line that passes from cell to cell through material.
    for (std::size_t k = 0; k < parts_.stretches.size(); ++k) {
      Index before = kNone;
      for (int along = parts_.first_cells[k]; along <= parts_.last_cells[k]; ++along) {
        const Index node = parts_.node_on(k, along);
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

  const PartNodes& parts_;
  NeighbourJoins neighbour_joins_;
  std::vector<Index> cubes_;         // cell of each cube
  std::vector<Index> cube_of_node_;  // by the root of a set of nodes
  std::vector<Index> touch_cubes_;
  std::vector<std::array<Index, 8>> nodes_;
};

}  // namespace

SplitCubes split_parts(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels) {
  const PartNodes parts(surface, tree, voxels);
  DisjointSets nodes(parts.count);
  join_by_material(parts, nodes);
  NeighbourJoins neighbour_joins = join_pieces_of_mesh(parts, nodes);
  return PartCubes(parts, nodes, std::move(neighbour_joins)).finish();
}

}  // namespace followthrough
