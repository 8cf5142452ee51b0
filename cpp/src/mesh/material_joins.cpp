// SPDX-License-Identifier: GPL-3.0-or-later
#include "material_joins.hpp"

#include <algorithm>
#include <array>
#include <map>
#include <utility>
#include <vector>

#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr std::size_t kLatticePoints = static_cast<std::size_t>(kLinesPerCell * kLinesPerCell * kLinesPerCell);
constexpr double kTwice = 1.65;  // winding number of an overlap; at a wall inside the body it comes up to 1.5
constexpr Index kNone = PartNodes::kNone;
constexpr Index kAmbiguous = -2;

class MaterialJoins {
 public:
  explicit MaterialJoins(const PartNodes& parts) : parts_(parts) {}

  // Where a line goes in and out, it meets patches.
  void join_along_stretches(DisjointSets& nodes) const {
    for (std::size_t k = 0; k < parts_.stretches.size(); ++k) {
      const Stretch& s = parts_.stretches[k];
      for (const auto& [along, triangle] : {std::pair(parts_.first_cells[k], s.enter), std::pair(parts_.last_cells[k], s.exit)}) {
        if (triangle == kNone) continue;
        const Index cell = parts_.cell_on(s, along);
        const std::size_t touch = parts_.touch_of(cell, triangle);
        if (touch != parts_.touch_end(cell)) nodes.join(parts_.touch_nodes[touch], parts_.node_on(k, along));
      }
    }
  }

  // Lines of three directions meet in the lattice's points: their stretches there are the same material, unless the body overlaps
  // itself.
  void join_at_lattice(DisjointSets& nodes) {
    for (auto& at : lattice_) at.assign(parts_.touched.size() * kLatticePoints, kNone);
    for (std::size_t k = 0; k < parts_.stretches.size(); ++k) {
      const Stretch& s = parts_.stretches[k];
      const int u = (s.axis + 1) % 3, v = (s.axis + 2) % 3;
      auto& at = lattice_[static_cast<std::size_t>(s.axis)];
      for (int along = parts_.first_cells[k]; along <= parts_.last_cells[k]; ++along) {
        const Index ordinal = parts_.ordinal[static_cast<std::size_t>(parts_.cell_on(s, along))];
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
          } else if (held != kAmbiguous && parts_.stretches[static_cast<std::size_t>(held)].shell != s.shell) {
            nodes.join(parts_.node_on(static_cast<std::size_t>(held), along),
                       parts_.node_on(k, along));  // pieces of the mesh that overlap
          } else {
            held = kAmbiguous;
          }
        }
      }
    }
    for (std::size_t p = 0; p < lattice_[0].size(); ++p) {
      const Eigen::Vector3i cell = parts_.grid.cell(parts_.touched[p / kLatticePoints]);
      Index together = kNone;
      for (int axis = 0; axis < 3; ++axis) {
        Index& held = lattice_[static_cast<std::size_t>(axis)][p];
        if (held < 0) continue;
        const Index node = parts_.node_on(static_cast<std::size_t>(held), cell[axis]);
        if (together == kNone) together = node;
        const bool clear = lattice_[0][p] != kAmbiguous && lattice_[1][p] != kAmbiguous && lattice_[2][p] != kAmbiguous;
        if (clear) nodes.join(together, node);
      }
    }
  }

  // What no line told: patches that see each other, or a point of the lattice, through material.
  void join_by_sight(DisjointSets& nodes) const {
#pragma omp parallel for schedule(dynamic, 8) num_threads(worthwhile_threads(std::ssize(parts_.touched), 2'000))
    for (std::size_t k = 0; k < parts_.touched.size(); ++k) look_around(k, nodes);
  }

 private:
  static std::size_t point_index(const std::array<int, 3>& local) {
    return static_cast<std::size_t>((local[0] * kLinesPerCell + local[1]) * kLinesPerCell + local[2]);
  }

  void look_around(std::size_t ordinal, DisjointSets& nodes) const {
    const Index cell = parts_.touched[ordinal];
    const Eigen::Vector3i at = parts_.grid.cell(cell);
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
        if (held >= 0 && node == kNone) node = parts_.node_on(static_cast<std::size_t>(held), at[static_cast<Eigen::Index>(axis)]);
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
    const Index first = nodes.find(parts_.touch_nodes[parts_.touch_begin(cell)]);
    for (std::size_t touch = parts_.touch_begin(cell); touch < parts_.touch_end(cell); ++touch)
      several |= nodes.find(parts_.touch_nodes[touch]) != first;
    for (const auto& [node, place] : lattice) several |= nodes.find(node) != first;
    if (!several) return;

    const CellView view(parts_.surface, parts_.voxels, cell);
    struct Below {
      std::size_t triangle;
      Eigen::Vector3d point;
      bool in_overlap;  // with another part of the body
    };
    std::map<Index, std::vector<Below>> below;  // by patch: a few points just inside it
    for (std::size_t touch = parts_.touch_begin(cell); touch < parts_.touch_end(cell); ++touch) {
      auto& points = below[parts_.touch_nodes[touch]];
      Eigen::Vector3d point;
      if (points.size() < 8 && view.point_below(touch - parts_.touch_begin(cell), point)) {
        points.push_back({touch - parts_.touch_begin(cell), point,
                          parts_.tree.winding_number_near(parts_.grid.from_grid(point), kTwice) > kTwice});
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

  const PartNodes& parts_;
  std::array<std::vector<Index>, 3> lattice_;  // by axis: the stretch at each point of the touched cells
};

}  // namespace

void join_by_material(const PartNodes& parts, DisjointSets& nodes) {
  MaterialJoins joins(parts);
  joins.join_along_stretches(nodes);
  joins.join_at_lattice(nodes);
  joins.join_by_sight(nodes);
}

}  // namespace followthrough
