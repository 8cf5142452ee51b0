// SPDX-License-Identifier: GPL-3.0-or-later
#include "host_joins.hpp"

#include <algorithm>
#include <limits>
#include <map>

#include <Eigen/Dense>

namespace followthrough {
namespace {

constexpr Index kNone = PartNodes::kNone;

class HostJoins {
 public:
  explicit HostJoins(const PartNodes& parts) : parts_(parts) {
    Vector areas = Vector::Zero(parts_.surface.component_count);
    for (Eigen::Index t = 0; t < parts_.surface.triangles.rows(); ++t) {
      const Eigen::Vector3d a = parts_.surface.vertices.row(parts_.surface.triangles(t, 0));
      const Eigen::Vector3d b = parts_.surface.vertices.row(parts_.surface.triangles(t, 1));
      const Eigen::Vector3d c = parts_.surface.vertices.row(parts_.surface.triangles(t, 2));
      areas[parts_.surface.components[t]] += (b - a).cross(c - a).norm();
    }
    std::vector<Index> order(static_cast<std::size_t>(parts_.surface.component_count));
    for (std::size_t k = 0; k < order.size(); ++k) order[k] = static_cast<Index>(k);
    std::stable_sort(order.begin(), order.end(), [&](Index a, Index b) { return areas[a] > areas[b]; });
    ranks_.resize(order.size());
    for (std::size_t k = 0; k < order.size(); ++k) ranks_[static_cast<std::size_t>(order[k])] = static_cast<Index>(k);
  }

  NeighbourJoins join(DisjointSets& nodes) {
    for (std::size_t k = 0; k < parts_.touched.size(); ++k) {
      const Index cell = parts_.touched[k];
      struct Group {
        Index largest = std::numeric_limits<Index>::max();
        std::vector<std::size_t> touches;  // of the largest piece of the mesh in it
      };
      std::map<Index, Group> groups;
      for (std::size_t touch = parts_.touch_begin(cell); touch < parts_.touch_end(cell); ++touch) {
        Group& group = groups[nodes.find(parts_.touch_nodes[touch])];
        if (area_rank(touch) < group.largest) group = {area_rank(touch), {}};
        if (area_rank(touch) == group.largest && group.touches.size() < 8) group.touches.push_back(touch);
      }
      const CellView view(parts_.surface, parts_.voxels, cell);
      for (const auto& [root, group] : groups) {
        if (group.largest == 0) continue;
        Eigen::Vector3d from;
        for (const std::size_t touch : group.touches) {
          if (view.point_below(touch - parts_.touch_begin(cell), from))
            join_to_host(nodes, cell, touch, parts_.grid.from_grid(from));
        }
      }
    }
    return std::move(neighbour_joins_);
  }

 private:
  Index area_rank(std::size_t touch) const {
    return ranks_[static_cast<std::size_t>(parts_.surface.components[parts_.voxels.touch_triangles[touch]])];
  }

  // Joins what carries a triangle to what carries the nearest one of a larger piece of the mesh.
  void join_to_host(DisjointSets& nodes, Index cell, std::size_t touch, const Eigen::Vector3d& point) {
    const auto closest = [&](Index t) {
      return closest_on_triangle(point, parts_.surface.vertices.row(parts_.surface.triangles(t, 0)),
                                 parts_.surface.vertices.row(parts_.surface.triangles(t, 1)),
                                 parts_.surface.vertices.row(parts_.surface.triangles(t, 2)));
    };
    const Eigen::Vector3d reach = Eigen::Vector3d::Constant(parts_.grid.edge);
    Index host = kNone;
    double nearest = parts_.grid.edge * parts_.grid.edge;
    parts_.tree.boxes().overlapping(Box(point - reach, point + reach), [&](Index t) {
      if (ranks_[static_cast<std::size_t>(parts_.surface.components[t])] >= area_rank(touch)) return;
      const double distance = closest(t).squared_distance;
      if (distance < nearest || (distance == nearest && host != kNone && t < host)) {
        nearest = distance;
        host = t;
      }
    });
    if (host == kNone) return;
    const std::size_t here = parts_.touch_of(cell, host);
    if (here != parts_.touch_end(cell)) {
      nodes.join(parts_.touch_nodes[touch], parts_.touch_nodes[here]);
      return;
    }
    const ClosestPoint on = closest(host);
    Eigen::Vector3d place = Eigen::Vector3d::Zero();
    for (int k = 0; k < 3; ++k)
      place += on.barycentric[k] * parts_.surface.vertices.row(parts_.surface.triangles(host, k)).transpose();
    const Eigen::Vector3i other = parts_.grid.to_grid(place).array().floor().cast<int>();
    if (!parts_.grid.contains(other) || (other - parts_.grid.cell(cell)).cwiseAbs().maxCoeff() > 1) return;
    const std::size_t there = parts_.touch_of(parts_.grid.number(other), host);
    if (there != parts_.touch_end(parts_.grid.number(other))) neighbour_joins_.emplace_back(touch, there);
  }

  const PartNodes& parts_;
  std::vector<Index> ranks_;  // of each piece of the mesh by area, the largest first
  NeighbourJoins neighbour_joins_;
};

}  // namespace

NeighbourJoins join_pieces_of_mesh(const PartNodes& parts, DisjointSets& nodes) {
  if (parts.surface.component_count < 2) return {};
  return HostJoins(parts).join(nodes);
}

}  // namespace followthrough
