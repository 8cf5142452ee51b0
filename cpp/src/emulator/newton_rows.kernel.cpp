// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes are rows of the matrix, so that a product needs no sum across lanes.
#include "aggregate_lanes.hpp"
#include "block_lanes.hpp"
#include "emulator/newton_kernel.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

inline void store(float* to, const Symmetric& m) {
  const Real values[] = {m.xx, m.yy, m.zz, m.xy, m.xz, m.yz};
  for (int k = 0; k < 6; ++k) store(to + k * kGroup, values[k]);
}
inline Triple operator*(const Symmetric& m, Triple v) {
  return {dot({m.xx, m.xy, m.xz}, v), dot({m.xy, m.yy, m.yz}, v), dot({m.xz, m.yz, m.zz}, v)};
}
inline Symmetric inverse_of(const Symmetric& m) {
  const Real xx = m.yy * m.zz - m.yz * m.yz, xy = m.xz * m.yz - m.xy * m.zz, xz = m.xy * m.yz - m.xz * m.yy;
  const Real scale = real(1.0f) / fma_of(m.xz, xz, fma_of(m.xy, xy, m.xx * xx));
  return {xx * scale, (m.xx * m.zz - m.xz * m.xz) * scale, (m.xx * m.yy - m.xy * m.xy) * scale, xy * scale,
          xz * scale, (m.xy * m.xz - m.xx * m.yz) * scale};
}

// The nine floats at each lane's place.
inline void gather_blocks(const float* sums, const std::int32_t* places, Real (&nine)[kBlock]) {
  for (int c = 0; c < kBlock; c += kLanes) {
    Lanes tile[kLanes];
    for (int k = 0; k < kLanes; ++k) tile[k] = load(sums + places[k] + c);
    transpose_tile(tile);
    for (int k = 0; k < kLanes && c + k < kBlock; ++k) nine[c + k] = {tile[k]};
  }
}

inline Triple times(Triple a, Triple b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }

// Adds masses times offsets of one kind of neighbours.
inline Triple add_inertia(const NewtonRows& rows, const std::int32_t* columns, const float* masses, std::int64_t first,
                          std::int64_t last, int lane, Triple sum) {
  for (std::int64_t slot = first; slot < last; ++slot) {
    const Triple offset = gather_triple(rows.offsets, columns + slot * kGroup + lane);
    sum = fma_of(offset, load_real(masses + slot * kGroup + lane), sum);
  }
  return sum;
}

template <typename Stored>
inline void assemble_blocks(const NewtonRows& rows, Stored* blocks, std::int64_t first_group, std::int64_t last_group) {
  const Real half = real(0.5f), one = real(kOne<Stored>);
  for (std::int64_t group = first_group; group < last_group; ++group) {
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const Triple scale = load_triple(rows.scales + 4 * (group * kGroup + lane));
      const Real own[3] = {scale.x, scale.y, scale.z};
      for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
        Real from[kBlock];
        gather_blocks(rows.sums, rows.slot_places + slot * kGroup + lane, from);
        const LaneMask turned = half < load_real(rows.slot_turned + slot * kGroup + lane);
        const Real mass = load_real(rows.slot_masses + slot * kGroup + lane);
        const Triple neighbour = gather_triple(rows.scales, rows.slot_columns + slot * kGroup + lane);
        const Real others[3] = {neighbour.x, neighbour.y, neighbour.z};
        Stored* out = blocks + slot * kBlock * kGroup + lane;
        for (int k = 0; k < kBlock; ++k) {
          const Real value = k % 4 == 0 ? from[k] + mass : choose(turned, from[k % 3 * 3 + k / 3], from[k]);
          store_numbers(out + k * kGroup, (value * (own[k / 3] * others[k % 3]) * one).v);
        }
      }
    }
  }
}

template <typename Stored>
inline void multiply_rows(const NewtonRows& rows, const Stored* blocks, std::int64_t first_group, std::int64_t last_group,
                          LaneSums* sums) {
  const Real unit = real(1.0f / kOne<Stored>);
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[0][lane] = 0.0f;
  for (std::int64_t group = first_group; group < last_group; ++group) {
    const std::int64_t row = group * kGroup;
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      Triple sum{real(0.0f), real(0.0f), real(0.0f)};
      for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
        const Triple other = gather_triple(rows.direction, rows.slot_columns + slot * kGroup + lane);
        const Stored* block = blocks + slot * kBlock * kGroup + lane;
        Real* const parts[] = {&sum.x, &sum.y, &sum.z};
        for (int k = 0; k < 3; ++k, block += 3 * kGroup) {
          const Triple line{{load_numbers(block)}, {load_numbers(block + kGroup)}, {load_numbers(block + 2 * kGroup)}};
          *parts[k] = fma_of(line.z, other.z, fma_of(line.y, other.y, fma_of(line.x, other.x, *parts[k])));
        }
      }
      const Triple own = load_triple(rows.direction + 4 * (row + lane));
      const Triple d = load_triple(rows.diagonal + group * 3 * kGroup + lane, kGroup);  // xy xz yz
      const Triple product = fma_of(sum, unit,
                                    {fma_of(d.y, own.z, fma_of(d.x, own.y, own.x)), fma_of(d.z, own.z, fma_of(d.x, own.x, own.y)),
                                     fma_of(d.z, own.y, fma_of(d.y, own.x, own.z))});
      store(rows.product + row + lane, rows.padded, product);
      store(&sums->sums[0][lane], load_real(&sums->sums[0][lane]) + dot(own, product));
    }
  }
}

}  // namespace

void assemble_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept {
  const Real zero = real(0.0f), one = real(1.0f);
  const Triple none{zero, zero, zero};
  for (int lane = 0; lane < kGroup; ++lane) {
    for (auto& sum : sums->sums) sum[lane] = 0.0f;
  }
  for (std::int64_t group = first_group; group < last_group; ++group) {
    const std::int64_t row = group * kGroup;
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      Real own[kBlock];
      gather_blocks(rows.sums, rows.row_places + row + lane, own);
      const Real mass = load_real(rows.masses + row + lane);
      const Real pin = rows.pins ? load_real(rows.pins + row + lane) : zero, stays = mass + pin;
      const Triple d{own[0] + stays, own[1] + stays, own[2] + stays};
      const Triple roots{root(d.x), root(d.y), root(d.z)};
      const Triple scale{one / roots.x, one / roots.y, one / roots.z};
      const Symmetric scaled{
          one, one, one, own[3] * (scale.x * scale.y), own[4] * (scale.x * scale.z), own[5] * (scale.y * scale.z)};
      const Symmetric inverse = inverse_of(scaled);
      // A NaN is not less than anything.
      const Real minor = one - scaled.xy * scaled.xy;
      const LaneMask definite = both(both(both(zero < d.x, zero < d.y), both(zero < d.z, zero < minor)), zero < inverse.zz);
      store(rows.scales + 4 * (row + lane), scale);
      store(rows.roots + row + lane, rows.padded, roots);
      store(rows.traces + row + lane, d.x + d.y + d.z);
      store(rows.diagonal + group * 3 * kGroup + lane, kGroup, Triple{scaled.xy, scaled.xz, scaled.yz});
      store(rows.inverse + group * 6 * kGroup + lane, inverse);
      const Triple offset = load_triple(rows.offsets + 4 * (row + lane));
      const Triple inertia = add_inertia(rows, rows.slot_columns, rows.slot_masses, rows.slot_starts[group],
                                         rows.slot_starts[group + 1], lane, offset * mass);
      const Triple border = add_inertia(rows, rows.border_columns, rows.border_masses, rows.border_starts[group],
                                        rows.border_starts[group + 1], lane, none);
      const Triple lag = rows.pins ? offset - load_triple(rows.ways + row + lane, rows.padded) : none, pull = lag * pin;
      const Triple force = Triple{own[6], own[7], own[8]} + inertia + border + pull;
      const Triple residual = times(none - force, scale), next = inverse * residual;
      const Triple first = times(next, scale);
      store(rows.first + row + lane, rows.padded, first);
      store(rows.residual + row + lane, rows.padded, residual);
      store(rows.preconditioned + row + lane, rows.padded, next);
      store(rows.direction + 4 * (row + lane), next);
      store(rows.solution + row + lane, rows.padded, none);
      store(&sums->sums[0][lane], load_real(&sums->sums[0][lane]) + dot(residual, next));
      store(&sums->sums[1][lane], load_real(&sums->sums[1][lane]) + dot(first, first));
      store(&sums->sums[3][lane], load_real(&sums->sums[3][lane]) + choose(definite, zero, one));
      // Between free vertices every product is met from either side.
      store(&sums->sums[2][lane],
            load_real(&sums->sums[2][lane]) + dot(offset, fma_of(inertia, real(0.5f), border)) + dot(lag, pull) * real(0.5f));
    }
  }
}

void assemble_blocks(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group) noexcept {
  if (rows.rounded_blocks) {
    assemble_blocks(rows, rows.rounded_blocks, first_group, last_group);
  } else {
    assemble_blocks(rows, rows.blocks, first_group, last_group);
  }
}

void multiply_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept {
  if (rows.rounded_blocks) {
    multiply_rows(rows, rows.rounded_blocks, first_group, last_group, sums);
  } else {
    multiply_rows(rows, rows.blocks, first_group, last_group, sums);
  }
}

void restrict_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group) noexcept {
  for_aggregates(rows.restricted, first_group, last_group, [&](std::int64_t group, int lane, AggregateSums& aggregate) {
    const std::int64_t row = group * kGroup + lane;
    aggregate.add(lane, times(load_triple(rows.roots + row, rows.padded), load_triple(rows.residual + row, rows.padded)));
  });
}

void advance_rows(const NewtonRows& rows, float length, std::int32_t first_group, std::int32_t last_group,
                  LaneSums* sums) noexcept {
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[1][lane] = 0.0f;
  const Real step = real(length), back = real(-length);
  for_aggregates(rows.restricted, first_group, last_group, [&](std::int64_t group, int lane, AggregateSums& aggregate) {
    const std::int64_t row = group * kGroup + lane;
    store(rows.solution + row, rows.padded,
          fma_of(load_triple(rows.direction + 4 * row), step, load_triple(rows.solution + row, rows.padded)));
    const Triple left = fma_of(load_triple(rows.product + row, rows.padded), back, load_triple(rows.residual + row, rows.padded));
    const Triple next = load_symmetric(rows.inverse + group * 6 * kGroup + lane) * left;
    store(rows.residual + row, rows.padded, left);
    store(rows.preconditioned + row, rows.padded, next);
    if (rows.restricted) aggregate.add(lane, times(load_triple(rows.roots + row, rows.padded), left));
    add_to(&sums->sums[1][lane], dot(left, next));
  });
}

void turn_rows(const NewtonRows& rows, float share, std::int32_t first_group, std::int32_t last_group) noexcept {
  const Real part = real(share);
  for (std::int64_t group = first_group; group < last_group; ++group) {
    Triple coarse{real(0.0f), real(0.0f), real(0.0f)};
    if (rows.corrections) {
      const float* const own = rows.corrections + group / aggregate_groups * 3;
      coarse = {real(own[0]), real(own[1]), real(own[2])};
    }
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int64_t row = group * kGroup + lane;
      Triple next = load_triple(rows.preconditioned + row, rows.padded);
      if (rows.corrections) {
        const Triple roots = load_triple(rows.roots + row, rows.padded);
        next = {fma_of(roots.x, coarse.x, next.x), fma_of(roots.y, coarse.y, next.y), fma_of(roots.z, coarse.z, next.z)};
      }
      store(rows.direction + 4 * row, fma_of(load_triple(rows.direction + 4 * row), part, next));
    }
  }
}

void unscale_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept {
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[2][lane] = 0.0f;
  for (std::int64_t group = first_group; group < last_group; ++group) {
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int64_t row = group * kGroup + lane;
      const Triple scale = load_triple(rows.scales + 4 * row), found = times(load_triple(rows.solution + row, rows.padded), scale);
      store(rows.solution + row, rows.padded, found);
      store(rows.preconditioned + row, rows.padded, times(load_triple(rows.preconditioned + row, rows.padded), scale));
      add_to(&sums->sums[2][lane], dot(found, found));
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
