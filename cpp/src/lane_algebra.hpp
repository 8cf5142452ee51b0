// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Numbers, vectors and 3x3 matrices of a register's width, for kernel files only: every lane has one of its own. And the way from
/// lanes to rows in memory and back.
#pragma once

#include "lanes.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

/// Items (tets, rows of the matrix, edges) that go together through a kernel: a register or more.
constexpr int kGroup = 16;

struct Real {
  Lanes v;
};
inline Real real(float a) { return {broadcast(a)}; }
inline Real load_real(const float* from) { return {load(from)}; }
inline void store(float* to, Real a) { store(to, a.v); }
inline Real operator+(Real a, Real b) { return {add(a.v, b.v)}; }
inline Real operator-(Real a, Real b) { return {subtract(a.v, b.v)}; }
inline Real operator*(Real a, Real b) { return {multiply(a.v, b.v)}; }
inline Real operator/(Real a, Real b) { return {divide(a.v, b.v)}; }
inline LaneMask operator<(Real a, Real b) { return less(a.v, b.v); }
inline Real fma_of(Real a, Real b, Real c) { return {multiply_add(a.v, b.v, c.v)}; }
inline Real choose(LaneMask m, Real a, Real b) { return {select(m, a.v, b.v)}; }
inline Real root(Real a) { return {square_root(a.v)}; }
inline Real not_below(float limit, Real a) { return {larger(broadcast(limit), a.v)}; }

struct Triple {
  Real x, y, z;
};
inline Triple operator+(Triple a, Triple b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Triple operator-(Triple a, Triple b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Triple operator*(Triple a, Real s) { return {a.x * s, a.y * s, a.z * s}; }
inline Triple fma_of(Triple a, Real s, Triple c) { return {fma_of(a.x, s, c.x), fma_of(a.y, s, c.y), fma_of(a.z, s, c.z)}; }
inline Real dot(Triple a, Triple b) { return fma_of(a.z, b.z, fma_of(a.y, b.y, a.x * b.x)); }
/// As dot, but fused nowhere: the same bits with every instruction set.
inline Real sum_of_products(Triple a, Triple b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Triple cross(Triple a, Triple b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

/// A row each.
struct Square {
  Triple x, y, z;
};
inline Triple operator*(const Square& m, Triple v) { return {dot(m.x, v), dot(m.y, v), dot(m.z, v)}; }
/// Row vector times matrix.
inline Triple operator*(Triple v, const Square& m) { return fma_of(m.z, v.z, fma_of(m.y, v.y, m.x * v.x)); }
inline Square operator*(const Square& a, const Square& b) { return {a.x * b, a.y * b, a.z * b}; }
inline Square cofactors(const Square& m) { return {cross(m.y, m.z), cross(m.z, m.x), cross(m.x, m.y)}; }
inline Square transposed(const Square& m) { return {{m.x.x, m.y.x, m.z.x}, {m.x.y, m.y.y, m.z.y}, {m.x.z, m.y.z, m.z.z}}; }
inline Real square_sum(const Square& m) { return dot(m.x, m.x) + dot(m.y, m.y) + dot(m.z, m.z); }
inline Square choose(LaneMask m, const Square& a, const Square& b) {
  return {{choose(m, a.x.x, b.x.x), choose(m, a.x.y, b.x.y), choose(m, a.x.z, b.x.z)},
          {choose(m, a.y.x, b.y.x), choose(m, a.y.y, b.y.y), choose(m, a.y.z, b.y.z)},
          {choose(m, a.z.x, b.z.x), choose(m, a.z.y, b.z.y), choose(m, a.z.z, b.z.z)}};
}

/// Component k of a vector or matrix is at from[k * stride], a lane after the other.
inline Triple load_triple(const float* from, long stride) {
  return {load_real(from), load_real(from + stride), load_real(from + 2 * stride)};
}
inline Square load_square(const float* from, long stride) {
  return {load_triple(from, stride), load_triple(from + 3 * stride, stride), load_triple(from + 6 * stride, stride)};
}
inline void store(float* to, long stride, Triple a) {
  store(to, a.x);
  store(to + stride, a.y);
  store(to + 2 * stride, a.z);
}
inline void store(float* to, long stride, const Square& m) {
  store(to, stride, m.x);
  store(to + 3 * stride, stride, m.y);
  store(to + 6 * stride, stride, m.z);
}

/// Six numbers of a group, 16 lanes each.
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

/// to[r * to_stride + c] = from[c * from_stride + r] for 16 rows and columns.
inline void transpose_group(const float* from, long from_stride, float* to, long to_stride) {
  for (int r = 0; r < kGroup; r += kLanes) {
    for (int c = 0; c < kGroup; c += kLanes) {
      Lanes tile[kLanes];
      for (int k = 0; k < kLanes; ++k) tile[k] = load(from + (c + k) * from_stride + r);
      transpose_tile(tile);
      for (int k = 0; k < kLanes; ++k) store(to + (r + k) * to_stride + c, tile[k]);
    }
  }
}

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
