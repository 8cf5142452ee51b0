// SPDX-License-Identifier: GPL-3.0-or-later
// Products are rounded before they are added, fused nowhere, so that all instruction sets give the same bits.
#include "elastic/lane_rows.hpp"

#include "aggregate_lanes.hpp"
#include "block_lanes.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

static_assert(kGroup == row_lanes && kGroup == single_lanes);

inline Triple product(const Symmetric& m, Triple v) {
  return {sum_of_products({m.xx, m.xy, m.xz}, v), sum_of_products({m.xy, m.yy, m.yz}, v), sum_of_products({m.xz, m.yz, m.zz}, v)};
}

// Adds up blocks of nine floats, and what follows them, into a row of 16.
inline void add_blocks(const float* stiffness, const std::int32_t* first, const std::int32_t* last, float* out) {
  constexpr int registers = (9 + kLanes - 1) / kLanes;
  Lanes sums[registers];
  for (int k = 0; k < registers; ++k) sums[k] = broadcast(0.0f);
  for (; first != last; ++first) {
    for (int k = 0; k < registers; ++k) sums[k] = add(sums[k], load(stiffness + *first + k * kLanes));
  }
  for (int k = 0; k < registers; ++k) store(out + k * kLanes, sums[k]);
}

inline void add_turned_blocks(const float* stiffness, const std::int32_t* first, const std::int32_t* last, float* out) {
  if (first == last) return;
  float sum[kGroup];
  add_blocks(stiffness, first, last, sum);
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) out[3 * i + j] += sum[3 * j + i];
  }
}

// Inverts a group's diagonal blocks; false where one of them is not positive definite.
inline bool invert_diagonal(const float* block, float* inverse) {
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    const Square m = load_square(block + lane, kGroup);
    const Real xx = m.y.y * m.z.z - m.y.z * m.y.z, xy = m.x.z * m.y.z - m.x.y * m.z.z, xz = m.x.y * m.y.z - m.x.z * m.y.y;
    const Real minor = m.x.x * m.y.y - m.x.y * m.x.y, determinant = m.x.x * xx + m.x.y * xy + m.x.z * xz, zero = real(0.0f);
    const unsigned definite = bits_of(both(both(zero < m.x.x, zero < minor), zero < determinant));
    if (definite != (1u << kLanes) - 1u) return false;
    const Real scale = real(1.0f) / determinant;
    const Real values[] = {xx * scale, (m.x.x * m.z.z - m.x.z * m.x.z) * scale, minor * scale, xy * scale,
                           xz * scale, (m.x.y * m.x.z - m.x.x * m.y.z) * scale};
    for (int k = 0; k < 6; ++k) store(inverse + k * kGroup + lane, values[k]);
  }
  return true;
}

inline void clear(RowSums* sums) {
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[0][lane] = sums->sums[1][lane] = 0.0f;
}

}  // namespace

void store_stiffness(const SingleStiffness& lanes, int count, float* to) noexcept {
  static_assert(sizeof(lanes.blocks) >= sizeof(float) * stiffness_floats * kGroup);
  const float* from = &lanes.blocks[0][0][0];
  if (count == kGroup) {
    for (int c = 0; c < stiffness_floats; c += kGroup) transpose_group(from + c * kGroup, kGroup, to + c, stiffness_floats);
    return;
  }
  for (int lane = 0; lane < count; ++lane) {
    for (int c = 0; c < stiffness_floats; ++c) to[lane * stiffness_floats + c] = from[c * kGroup + lane];
  }
}

bool assemble_lane_rows(const LaneRows& rows, const float* stiffness, float* coarse_sums, std::int32_t first,
                        std::int32_t last) noexcept {
  float lanes[kGroup][kGroup], columns[kGroup][kGroup];
  bool definite = true;
  for (std::int64_t group = first; group < last; ++group) {
    for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
      const std::int32_t* starts = rows.share_starts + slot * 2 * kGroup;
      for (int lane = 0; lane < kGroup; ++lane, starts += 2) {
        add_blocks(stiffness, rows.share_blocks + starts[0], rows.share_blocks + starts[1], lanes[lane]);
        add_turned_blocks(stiffness, rows.share_blocks + starts[1], rows.share_blocks + starts[2], lanes[lane]);
      }
      if (coarse_sums) {
        for (int lane = 0; lane < kGroup; ++lane) {
          const std::int32_t place = rows.coarse_places[slot * kGroup + lane];
          if (place >= 0) add_block(coarse_sums + place, lanes[lane]);
        }
      }
      transpose_group(lanes[0], kGroup, columns[0], kGroup);
      float* out = rows.blocks + slot * 9 * kGroup;
      const float* masses = rows.masses + slot * kGroup;
      for (int lane = 0; lane < kGroup; lane += kLanes) {
        const Real mass = load_real(masses + lane);
        for (int k = 0; k < 9; ++k) {
          const Real value = load_real(&columns[k][lane]);
          store(out + k * kGroup + lane, k % 4 == 0 ? value + mass : value);
        }
      }
    }
    const std::int64_t diagonal = rows.slot_starts[group];
    definite = invert_diagonal(rows.blocks + diagonal * 9 * kGroup, rows.inverse + group * 6 * kGroup) && definite;
  }
  return definite;
}

void start_lane_rows(const LaneRows& rows, const LaneVectors& v, std::int32_t first, std::int32_t last, RowSums* sums) noexcept {
  clear(sums);
  const Real zero = real(0.0f);
  for_aggregates(v.restricted, first, last, [&](std::int64_t group, int lane, AggregateSums& aggregate) {
    const std::int64_t row = group * kGroup + lane;
    const Triple residual = load_triple(v.residual + row, rows.padded);
    const Triple next = product(load_symmetric(rows.inverse + group * 6 * kGroup + lane), residual);
    store(v.preconditioned + row, rows.padded, next);
    store(v.direction + 4 * row, Triple{zero, zero, zero});
    store(v.solution + row, rows.padded, Triple{zero, zero, zero});
    aggregate.add(lane, residual);
    add_to(&sums->sums[0][lane], sum_of_products(residual, next));
    add_to(&sums->sums[1][lane], sum_of_products(residual, residual));
  });
}

void multiply_lane_rows(const LaneRows& rows, const LaneVectors& v, std::int32_t first, std::int32_t last, RowSums* sums) noexcept {
  clear(sums);
  const Real zero = real(0.0f);
  for (std::int64_t group = first; group < last; ++group) {
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int64_t row = group * kGroup + lane;
      Triple sum{zero, zero, zero};
      for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
        const Triple other = gather_triple(v.direction, rows.columns + slot * kGroup + lane);
        const Square block = load_square(rows.blocks + slot * 9 * kGroup + lane, kGroup);
        sum = sum + Triple{sum_of_products(block.x, other), sum_of_products(block.y, other), sum_of_products(block.z, other)};
      }
      store(v.product + row, rows.padded, sum);
      add_to(&sums->sums[0][lane], sum_of_products(load_triple(v.direction + 4 * row), sum));
    }
  }
}

void advance_lane_rows(const LaneRows& rows, const LaneVectors& v, float length, std::int32_t first, std::int32_t last,
                       RowSums* sums) noexcept {
  clear(sums);
  const Real step = real(length);
  for_aggregates(v.restricted, first, last, [&](std::int64_t group, int lane, AggregateSums& aggregate) {
    const std::int64_t row = group * kGroup + lane;
    store(v.solution + row, rows.padded, load_triple(v.solution + row, rows.padded) + load_triple(v.direction + 4 * row) * step);
    const Triple left = load_triple(v.residual + row, rows.padded) - load_triple(v.product + row, rows.padded) * step;
    const Triple next = product(load_symmetric(rows.inverse + group * 6 * kGroup + lane), left);
    store(v.residual + row, rows.padded, left);
    store(v.preconditioned + row, rows.padded, next);
    aggregate.add(lane, left);
    add_to(&sums->sums[0][lane], sum_of_products(left, next));
    add_to(&sums->sums[1][lane], sum_of_products(left, left));
  });
}

void turn_lane_rows(const LaneRows& rows, const LaneVectors& v, float share, std::int32_t first, std::int32_t last) noexcept {
  const Real part = real(share), zero = real(0.0f);
  for (std::int64_t group = first; group < last; ++group) {
    Triple coarse{zero, zero, zero};
    if (v.coarse) {
      const float* const own = v.coarse + group / aggregate_groups * 3;
      coarse = {real(own[0]), real(own[1]), real(own[2])};
    }
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int64_t row = group * kGroup + lane;
      const Triple next = load_triple(v.preconditioned + row, rows.padded) + coarse;
      store(v.direction + 4 * row, next + load_triple(v.direction + 4 * row) * part);
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
