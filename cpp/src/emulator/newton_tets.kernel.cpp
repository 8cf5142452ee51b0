// SPDX-License-Identifier: GPL-3.0-or-later
// F is the deformation gradient, A its cofactors, J its determinant, E = (F^T F - 1) / 2, S = 2 mu E + lambda tr(E) 1, g a corner's
// gradient. The force on a corner is volume (F S + pressure A) g; the stiffness between two, made convex, is volume times
// share (g_a . S g_b) 1 + mu ((g_a . g_b) F F^T + F g_b (F g_a)^T) + lambda F g_a (F g_b)^T + bulk A g_a (A g_b)^T, where the share
// is 1 if S is positive definite and 0 if not. The energy is volume times E : S / 2 + resistance ((1 - J) / 12)^3, and below the
// clamp what the clamped stress does from there.
#include "block_lanes.hpp"
#include "emulator/newton_kernel.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

static_assert(kGroup == kNewtonGroup);

// Edges from the first corner, component k of edge e at [3 k + e]: taken in double precision, so that they are as exact far away.
inline void load_edges(const double* positions, const std::int32_t* corners, float (*edges)[kGroup]) {
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    for (int e = 0; e < 3; ++e) {
      const Triple edge = difference_of_triples(positions, corners + lane, corners + (e + 1) * kGroup + lane);
      store(&edges[e][lane], edge.x);
      store(&edges[3 + e][lane], edge.y);
      store(&edges[6 + e][lane], edge.z);
    }
  }
}

// F into the rows 0 to 8 of f; clamped where the test cannot say that all stretches are far above the clamp. What the clamp took
// off is in `below`, where it returns that there is any.
inline bool deformation_gradients(const NewtonTets& tets, std::int64_t group, float (*f)[kGroup], float (*below)[kGroup]) {
  bool any = false;
  float edges[9][kGroup];
  load_edges(tets.positions, tets.corners + group * 4 * kGroup, edges);
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    const Square gradient = load_square(&edges[0][lane], kGroup) * load_square(tets.gradients + group * 9 * kGroup + lane, kGroup);
    store(&f[0][lane], kGroup, gradient);
    const Real volume = dot(gradient.x, cofactors(gradient).x);
    unsigned sound = bits_of(real(0.05f) * square_sum(gradient) < volume);
    for (int k = 0; k < kLanes; ++k, sound >>= 1) {
      if (sound & 1u) continue;
      float one[9];
      for (int c = 0; c < 9; ++c) one[c] = f[c][lane + k];
      tets.raise_stretches(one);
      if (!any) {
        for (int c = 0; c < 9; ++c) {
          for (int other = 0; other < kGroup; ++other) below[c][other] = 0.0f;
        }
        any = true;
      }
      for (int c = 0; c < 9; ++c) {
        below[c][lane + k] = f[c][lane + k] - one[c];
        f[c][lane + k] = one[c];
      }
    }
  }
  return any;
}

inline void store_corner(float (*out)[kGroup], int lane, const Symmetric& stiffness, Triple force) {
  const Real values[] = {stiffness.xx, stiffness.yy, stiffness.zz, stiffness.xy, stiffness.xz,
                         stiffness.yz, force.x,      force.y,      force.z};
  for (int k = 0; k < kBlock; ++k) store(&out[k][lane], values[k]);
}

inline Square whole(const Symmetric& m) { return {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}}; }
inline Square operator+(const Square& a, const Square& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Triple negative(Triple a) {
  const Real zero = real(0.0f);
  return {zero - a.x, zero - a.y, zero - a.z};
}
inline Square negative(const Square& a) { return {negative(a.x), negative(a.y), negative(a.z)}; }

// below: what the clamp took off, or null.
inline void shares_of(const NewtonTets& tets, std::int64_t group, const float (*gradient)[kGroup], const float (*below)[kGroup],
                      float (*out)[kGroup]) {
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    const float* constants = tets.materials + group * 4 * kGroup + lane;
    const Real volume = load_real(constants), mu = load_real(constants + kGroup);
    const Real lambda = load_real(constants + 2 * kGroup), resistance = load_real(constants + 3 * kGroup);
    const Square g = load_square(tets.gradients + group * 9 * kGroup + lane, kGroup);
    const Square f = load_square(&gradient[0][lane], kGroup);
    const Square a = cofactors(f), columns = transposed(f);
    const Real one = real(1.0f), half = real(0.5f), zero = real(0.0f);
    const Real cxx = dot(columns.x, columns.x) - one, cyy = dot(columns.y, columns.y) - one, czz = dot(columns.z, columns.z) - one;
    const Real cxy = dot(columns.x, columns.y), cxz = dot(columns.x, columns.z), cyz = dot(columns.y, columns.z);
    const Real tension = lambda * half * (cxx + cyy + czz);
    const Square s{{fma_of(mu, cxx, tension), mu * cxy, mu * cxz},
                   {mu * cxy, fma_of(mu, cyy, tension), mu * cyz},
                   {mu * cxz, mu * cyz, fma_of(mu, czz, tension)}};
    const Real gap = not_below(0.0f, one - dot(f.x, a.x));
    const Real pressure = resistance * gap * gap * real(-1.0f / 576.0f), bulk = resistance * gap * real(1.0f / 288.0f) * volume;
    const Real minor = s.x.x * s.y.y - s.x.y * s.x.y, determinant = dot(s.x, cross(s.y, s.z));
    const LaneMask stretched = both(both(zero < s.x.x, zero < minor), zero < determinant);
    const Real near = tets.exact ? volume : choose(stretched, volume, zero), squeeze = tets.exact ? pressure * volume : zero;
    const Real shear = volume * mu, spread = volume * lambda;
    Real strained = fma_of(czz, s.z.z, fma_of(cyy, s.y.y, cxx * s.x.x)) + dot({cxy, cxz, cyz}, {s.x.y, s.x.z, s.y.z}) * real(2.0f);
    strained = strained * real(0.25f) + resistance * gap * gap * gap * real(1.0f / 1728.0f);
    // What F, A and S make of the gradients of the corners but the first, which has what brings all sums over corners to nothing.
    const Square stress = f * s;
    const Square pull = {fma_of(a.x, pressure, stress.x) * volume, fma_of(a.y, pressure, stress.y) * volume,
                         fma_of(a.z, pressure, stress.z) * volume};
    if (below) {
      const Square lost = load_square(&below[0][lane], kGroup);
      store(tets.energies + group * kGroup + lane,
            fma_of(strained, volume, dot(pull.x, lost.x) + dot(pull.y, lost.y) + dot(pull.z, lost.z)));
    } else {
      store(tets.energies + group * kGroup + lane, strained * volume);
    }
    const Triple corner[] = {g.x, g.y, g.z};
    const Real fxx = dot(f.x, f.x), fyy = dot(f.y, f.y), fzz = dot(f.z, f.z);
    const Real fxy = dot(f.x, f.y), fxz = dot(f.x, f.z), fyz = dot(f.y, f.z);
    Triple moved[3], normal[3], pulled[3], force[3];
    Symmetric own[3];
    for (int c = 0; c < 3; ++c) {
      moved[c] = f * corner[c];
      normal[c] = a * corner[c];
      pulled[c] = s * corner[c];
      force[c] = pull * corner[c];
      const Real same = shear * dot(corner[c], corner[c]), along = near * dot(corner[c], pulled[c]);
      const Triple m = moved[c] * (shear + spread), n = normal[c] * bulk;
      const auto entry = [&](Real ff, Real left, Real right, Real up, Real down) {
        return fma_of(up, down, fma_of(left, right, same * ff));
      };
      own[c] = {entry(fxx, m.x, moved[c].x, n.x, normal[c].x) + along, entry(fyy, m.y, moved[c].y, n.y, normal[c].y) + along,
                entry(fzz, m.z, moved[c].z, n.z, normal[c].z) + along, entry(fxy, m.x, moved[c].y, n.x, normal[c].y),
                entry(fxz, m.x, moved[c].z, n.x, normal[c].z),         entry(fyz, m.y, moved[c].z, n.y, normal[c].z)};
      store_corner(out + kBlock * (1 + c), lane, own[c], force[c]);
    }
    const auto between = [&](int b, int c) {
      const Real same = shear * dot(corner[b], corner[c]), along = near * dot(corner[b], pulled[c]);
      const Triple by_c = moved[c] * shear, by_b = moved[b] * spread, n = normal[b] * bulk;
      const auto row = [&](Triple ff, Real c_side, Real b_side, Real up) {
        return fma_of(normal[c], up, fma_of(moved[c], b_side, fma_of(moved[b], c_side, ff * same)));
      };
      Square k{row({fxx, fxy, fxz}, by_c.x, by_b.x, n.x), row({fxy, fyy, fyz}, by_c.y, by_b.y, n.y),
               row({fxz, fyz, fzz}, by_c.z, by_b.z, n.z)};
      k.x.x = k.x.x + along;
      k.y.y = k.y.y + along;
      k.z.z = k.z.z + along;
      if (tets.exact) {
        const Triple axis = f * cross(corner[b], corner[c]) * squeeze;
        k.x.y = k.x.y + axis.z;
        k.x.z = k.x.z - axis.y;
        k.y.x = k.y.x - axis.z;
        k.y.z = k.y.z + axis.x;
        k.z.x = k.z.x + axis.y;
        k.z.y = k.z.y - axis.x;
      }
      return k;
    };
    const auto store_between = [&](int block, const Square& k) { store(&out[kBlock * block][lane], kGroup, k); };
    const Square second = between(0, 1), third = between(0, 2), last = between(1, 2);
    store_between(7, second);
    store_between(8, third);
    store_between(9, last);
    const Square first[] = {negative(whole(own[0]) + transposed(second) + transposed(third)),
                            negative(second + whole(own[1]) + transposed(last)), negative(third + last + whole(own[2]))};
    for (int c = 0; c < 3; ++c) store_between(4 + c, first[c]);
    const Square rest = negative(first[0] + first[1] + first[2]);
    store_corner(out, lane, {rest.x.x, rest.y.y, rest.z.z, rest.x.y, rest.x.z, rest.y.z}, negative(force[0] + force[1] + force[2]));
  }
}

}  // namespace

void add_tets(const NewtonTets& tets, std::int32_t first_group, std::int32_t last_group) noexcept {
  float blocks[kTetBlocks][kBlock][kGroup], gradient[9][kGroup], below[9][kGroup];
  for (std::int64_t group = first_group; group < last_group; ++group) {
    const bool any_below = deformation_gradients(tets, group, gradient, below);
    shares_of(tets, group, gradient, any_below ? below : nullptr, blocks[0]);
    const std::int32_t* places = tets.places + group * kGroup * kTetBlocks;
    for (int block = 0; block < kTetBlocks; ++block) add_group_of_blocks(blocks[block], tets.sums, places + block * kGroup);
  }
}

void add_blocks(const std::int32_t* places, std::int32_t pairs, const float* from, float* to) noexcept {
  for (std::int32_t k = 0; k < pairs; ++k, places += 2) add_block(to + places[0], from + places[1]);
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
