// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Sums over aggregates of rows, for kernel files only: groups of 16 rows that follow each other and move as one in a coarse
/// system.
#pragma once

#include <cstdint>

#include "aggregates.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

inline void add_to(float* sum, Real value) { store(sum, load_real(sum) + value); }

/// Of a vector over an aggregate, lane by lane until it ends.
struct AggregateSums {
  float lanes[3][kGroup];
  void clear() {
    for (auto& axis : lanes) {
      for (float& lane : axis) lane = 0.0f;
    }
  }
  void add(int lane, Triple value) {
    add_to(&lanes[0][lane], value.x);
    add_to(&lanes[1][lane], value.y);
    add_to(&lanes[2][lane], value.z);
  }
  void fold_into(float* to) {
    for (int axis = 0; axis < 3; ++axis) {
      for (int half = kGroup / 2; half > 0; half /= 2) {
        for (int lane = 0; lane < half; ++lane) lanes[axis][lane] += lanes[axis][lane + half];
      }
      to[axis] = lanes[axis][0];
    }
  }
};

/// Calls work(group, lane, sums of the aggregate) for all rows, kLanes at a time, and puts three sums an aggregate into
/// `restricted` where it is not null.
template <typename Work>
inline void for_aggregates(float* restricted, std::int32_t first, std::int32_t last, const Work& work) {
  AggregateSums sums;
  for (std::int64_t group = first; group < last; ++group) {
    if (group == first || group % aggregate_groups == 0) sums.clear();
    for (int lane = 0; lane < kGroup; lane += kLanes) work(group, lane, sums);
    const bool ends = group + 1 == last || (group + 1) % aggregate_groups == 0;
    if (restricted && ends) sums.fold_into(restricted + group / aggregate_groups * 3);
  }
}

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
