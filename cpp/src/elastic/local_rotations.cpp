// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/local_rotations.hpp"

#include <algorithm>
#include <utility>

#include "elastic/rotation_rows.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr std::size_t lanes = rotation_lanes;
constexpr double group_nanoseconds = 800;

decltype(&baseline::turn_rotation_rows) turn_kernel() { return FOLLOWTHROUGH_KERNEL(turn_rotation_rows); }

// Relative to their mean, so that single precision will do far from the origin.
void put(ConstPositions positions, std::vector<float>& to) {
  const Eigen::RowVector3d middle = positions.colwise().mean();
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    for (int axis = 0; axis < 3; ++axis) to[4 * v + axis] = static_cast<float>(positions(v, axis) - middle[axis]);
  }
}

}  // namespace

LocalRotations::LocalRotations(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count,
                               std::vector<Index> vertices)
    : vertices_(std::move(vertices)), from_(4 * static_cast<std::size_t>(vertex_count)), to_(from_.size()) {
  std::vector<std::vector<Index>> neighbours(static_cast<std::size_t>(vertex_count));
  for (const std::array<Index, 4>& tet : corners) {
    for (const Index a : tet) {
      for (const Index b : tet) {
        if (a != b) neighbours[a].push_back(b);
      }
    }
  }
  slot_starts_.push_back(0);
  for (std::size_t first = 0; first < vertices_.size(); first += lanes) {
    std::size_t most = 0;
    for (std::size_t lane = 0; lane < lanes; ++lane) {
      const Index v = vertices_[std::min(first + lane, vertices_.size() - 1)];
      own_.push_back(4 * v);
      std::vector<Index>& all = neighbours[v];
      std::sort(all.begin(), all.end());
      all.erase(std::unique(all.begin(), all.end()), all.end());
      most = std::max(most, all.size());
    }
    for (std::size_t slot = 0; slot < most; ++slot) {
      for (std::size_t lane = 0; lane < lanes; ++lane) {
        const std::int32_t own = own_[first + lane];
        const std::vector<Index>& all = neighbours[own / 4];
        neighbours_.push_back(slot < all.size() ? 4 * all[slot] : own);
      }
    }
    slot_starts_.push_back(slot_starts_.back() + static_cast<std::int32_t>(most));
  }
  values_.resize(4 * own_.size());
}

void LocalRotations::turn(ConstPositions from, ConstPositions to, Positions& values) {
  put(from, from_);
  put(to, to_);
  for (std::size_t k = 0; k < vertices_.size(); ++k) {
    for (int axis = 0; axis < 3; ++axis) values_[4 * k + axis] = static_cast<float>(values(vertices_[k], axis));
  }
  const auto kernel = turn_kernel();
  const RotationRows rows{own_.data(), slot_starts_.data(), neighbours_.data()};
  const auto groups = static_cast<std::int32_t>(slot_starts_.size()) - 1;
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(groups, group_nanoseconds))
  for (std::int32_t group = 0; group < groups; ++group) kernel(rows, from_.data(), to_.data(), values_.data(), group, group + 1);
  for (std::size_t k = 0; k < vertices_.size(); ++k) {
    for (int axis = 0; axis < 3; ++axis) values(vertices_[k], axis) = static_cast<double>(values_[4 * k + axis]);
  }
}

}  // namespace followthrough
