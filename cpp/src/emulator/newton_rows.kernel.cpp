// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes are rows of the matrix, so that a product needs no sum across lanes.
#include "emulator/newton_kernel.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

struct Symmetric {
  Real xx, yy, zz, xy, xz, yz;
};
inline Symmetric load_symmetric(const float* from) {
  return {load_real(from),
          load_real(from + kGroup),
          load_real(from + 2 * kGroup),
          load_real(from + 3 * kGroup),
          load_real(from + 4 * kGroup),
          load_real(from + 5 * kGroup)};
}
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

// Adds up blocks of nine floats (a register may read beyond them) into a row of 16.
inline void add_blocks(const float* shares, const std::int32_t* first, const std::int32_t* last, float* out) {
  constexpr int registers = (9 + kLanes - 1) / kLanes;
  Lanes sums[registers];
  for (int k = 0; k < registers; ++k) sums[k] = broadcast(0.0f);
  for (; first != last; ++first) {
    for (int k = 0; k < registers; ++k) sums[k] = add(sums[k], load(shares + *first + k * kLanes));
  }
  for (int k = 0; k < registers; ++k) store(out + k * kLanes, sums[k]);
}

inline Triple gather_triple(const float* from, std::int32_t stride, const std::int32_t* index) {
  return {{gather(from, index)}, {gather(from + stride, index)}, {gather(from + 2 * static_cast<std::int64_t>(stride), index)}};
}

// One group's blocks, from the tets' shares.
inline void assemble_blocks(const NewtonRows& rows, std::int64_t group) {
  float lanes[kGroup][kGroup], columns[kGroup][kGroup];
  for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
    const std::int32_t* starts = rows.share_starts + slot * kGroup;
    std::uint32_t turned = rows.slot_turned[slot];
    for (int lane = 0; lane < kGroup; ++lane, turned >>= 1) {
      float* row = lanes[lane];
      add_blocks(rows.shares, rows.share_blocks + starts[lane], rows.share_blocks + starts[lane + 1], row);
      if (turned & 1u) {
        const float xy = row[1], xz = row[2], yz = row[5];
        row[1] = row[3];
        row[2] = row[6];
        row[5] = row[7];
        row[3] = xy;
        row[6] = xz;
        row[7] = yz;
      }
    }
    transpose_group(lanes[0], kGroup, columns[0], kGroup);
    float* out = rows.blocks + slot * 9 * kGroup;
    const float* masses = rows.slot_masses + slot * kGroup;
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const Real mass = load_real(masses + lane);
      for (int k = 0; k < 9; ++k) {
        const Real value = load_real(&columns[k][lane]);
        store(out + k * kGroup + lane, k % 4 == 0 ? value + mass : value);
      }
    }
  }
}

// Adds masses times offsets of one kind of neighbours.
inline Triple add_inertia(const NewtonRows& rows, const std::int32_t* columns, const float* masses, std::int64_t first,
                          std::int64_t last, int lane, Triple sum) {
  for (std::int64_t slot = first; slot < last; ++slot) {
    const Triple offset = gather_triple(rows.offsets, rows.offset_stride, columns + slot * kGroup + lane);
    sum = fma_of(offset, load_real(masses + slot * kGroup + lane), sum);
  }
  return sum;
}

}  // namespace

void assemble_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept {
  float lanes[kGroup][kGroup], columns[kGroup][kGroup];
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[0][lane] = sums->sums[1][lane] = 0.0f;
  for (std::int64_t group = first_group; group < last_group; ++group) {
    assemble_blocks(rows, group);
    const std::int64_t row = group * kGroup;
    for (int lane = 0; lane < kGroup; ++lane) {
      const std::int32_t* starts = rows.tet_starts + row + lane;
      add_blocks(rows.shares, rows.tet_blocks + starts[0], rows.tet_blocks + starts[1], lanes[lane]);
    }
    transpose_group(lanes[0], kGroup, columns[0], kGroup);
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      Symmetric d = load_symmetric(&columns[0][lane]);
      const Real mass = load_real(rows.masses + row + lane);
      d.xx = d.xx + mass;
      d.yy = d.yy + mass;
      d.zz = d.zz + mass;
      const Symmetric inverse = inverse_of(d);
      store(rows.diagonal + group * 6 * kGroup + lane, d);
      store(rows.inverse + group * 6 * kGroup + lane, inverse);
      Triple force =
          fma_of(load_triple(rows.offsets + row + lane, rows.offset_stride), mass, load_triple(&columns[6][lane], kGroup));
      force =
          add_inertia(rows, rows.slot_columns, rows.slot_masses, rows.slot_starts[group], rows.slot_starts[group + 1], lane, force);
      force = add_inertia(rows, rows.border_columns, rows.border_masses, rows.border_starts[group], rows.border_starts[group + 1],
                          lane, force);
      const Real zero = real(0.0f);
      const Triple residual{zero - force.x, zero - force.y, zero - force.z}, first = inverse * residual;
      store(rows.residual + row + lane, rows.padded, residual);
      store(rows.preconditioned + row + lane, rows.padded, first);
      store(rows.direction + row + lane, rows.padded, first);
      store(rows.solution + row + lane, rows.padded, Triple{zero, zero, zero});
      store(&sums->sums[0][lane], load_real(&sums->sums[0][lane]) + dot(residual, first));
      store(&sums->sums[1][lane], load_real(&sums->sums[1][lane]) + dot(first, first));
    }
  }
}

void multiply_rows(const NewtonRows& rows, std::int32_t first_group, std::int32_t last_group, LaneSums* sums) noexcept {
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[0][lane] = 0.0f;
  for (std::int64_t group = first_group; group < last_group; ++group) {
    const std::int64_t row = group * kGroup;
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const Triple own = load_triple(rows.direction + row + lane, rows.padded);
      Triple sum = load_symmetric(rows.diagonal + group * 6 * kGroup + lane) * own;
      for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
        const Triple other = gather_triple(rows.direction, rows.padded, rows.slot_columns + slot * kGroup + lane);
        const float* block = rows.blocks + slot * 9 * kGroup + lane;
        Real* const parts[] = {&sum.x, &sum.y, &sum.z};
        for (int k = 0; k < 3; ++k) {
          const Triple line = load_triple(block + 3 * k * kGroup, kGroup);
          *parts[k] = fma_of(line.z, other.z, fma_of(line.y, other.y, fma_of(line.x, other.x, *parts[k])));
        }
      }
      store(rows.product + row + lane, rows.padded, sum);
      store(&sums->sums[0][lane], load_real(&sums->sums[0][lane]) + dot(own, sum));
    }
  }
}

void advance_rows(const NewtonRows& rows, float length, std::int32_t first_group, std::int32_t last_group,
                  LaneSums* sums) noexcept {
  for (int lane = 0; lane < kGroup; ++lane) sums->sums[0][lane] = 0.0f;
  const Real step = real(length), back = real(-length);
  for (std::int64_t group = first_group; group < last_group; ++group) {
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int64_t row = group * kGroup + lane;
      store(rows.solution + row, rows.padded,
            fma_of(load_triple(rows.direction + row, rows.padded), step, load_triple(rows.solution + row, rows.padded)));
      const Triple left = fma_of(load_triple(rows.product + row, rows.padded), back, load_triple(rows.residual + row, rows.padded));
      const Triple next = load_symmetric(rows.inverse + group * 6 * kGroup + lane) * left;
      store(rows.residual + row, rows.padded, left);
      store(rows.preconditioned + row, rows.padded, next);
      store(&sums->sums[0][lane], load_real(&sums->sums[0][lane]) + dot(left, next));
    }
  }
}

void turn_rows(const NewtonRows& rows, float share, std::int32_t first_group, std::int32_t last_group) noexcept {
  const Real part = real(share);
  for (std::int64_t row = std::int64_t{first_group} * kGroup; row < std::int64_t{last_group} * kGroup; row += kLanes) {
    store(rows.direction + row, rows.padded,
          fma_of(load_triple(rows.direction + row, rows.padded), part, load_triple(rows.preconditioned + row, rows.padded)));
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
