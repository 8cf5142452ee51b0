// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A register of floats under one name for every instruction set, for kernel files only: everything here lives in the set's own
/// namespace, so that the linker cannot mix them.
#pragma once

#if defined(__AVX2__) || defined(__SSE2__) || defined(_M_X64)
#include <immintrin.h>
#elif defined(__aarch64__) || defined(_M_ARM64)
#include <arm_neon.h>
#else
#include <math.h>
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// multiply_add(a, b, c) is a b + c, rounded once where the set can. smaller(limit, x) and larger(limit, x) keep x where it is NaN.
// select(m, a, b) is a where m holds and b elsewhere; gather reads from + index[lane]. transpose_tile turns kLanes registers, rows
// of a square, into its columns. kTileRows x kTileColumns registers hold the sums of a tile and leave a few for what goes into
// them.
#if defined(__AVX512F__)
using Lanes = __m512;
constexpr int kLanes = 16, kTileRows = 12, kTileColumns = 2;
inline Lanes load(const float* from) { return _mm512_loadu_ps(from); }
inline void store(float* to, Lanes a) { _mm512_storeu_ps(to, a); }
inline Lanes broadcast(float a) { return _mm512_set1_ps(a); }
inline Lanes add(Lanes a, Lanes b) { return _mm512_add_ps(a, b); }
inline Lanes subtract(Lanes a, Lanes b) { return _mm512_sub_ps(a, b); }
inline Lanes square_root(Lanes a) { return _mm512_sqrt_ps(a); }
using LaneMask = __mmask16;
inline LaneMask less(Lanes a, Lanes b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
inline LaneMask both(LaneMask a, LaneMask b) { return static_cast<LaneMask>(a & b); }
inline Lanes select(LaneMask m, Lanes a, Lanes b) { return _mm512_mask_blend_ps(m, b, a); }
inline unsigned bits_of(LaneMask m) { return m; }
inline Lanes gather(const float* from, const int* index) { return _mm512_i32gather_ps(_mm512_loadu_si512(index), from, 4); }
inline void transpose_tile(Lanes* rows) {
  Lanes pairs[16], fours[16];
  for (int k = 0; k < 16; k += 2) {
    pairs[k] = _mm512_unpacklo_ps(rows[k], rows[k + 1]);
    pairs[k + 1] = _mm512_unpackhi_ps(rows[k], rows[k + 1]);
  }
  for (int k = 0; k < 16; k += 4) {
    for (int h = 0; h < 2; ++h) {
      const __m512d a = _mm512_castps_pd(pairs[k + h]), b = _mm512_castps_pd(pairs[k + h + 2]);
      fours[k + 2 * h] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
      fours[k + 2 * h + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
    }
  }
  // fours[4 q + c] has column c + 4 p of the rows 4 q to 4 q + 3 in its quarter p.
  for (int c = 0; c < 4; ++c) {
    const Lanes even_low = _mm512_shuffle_f32x4(fours[c], fours[4 + c], 0x88),
                odd_low = _mm512_shuffle_f32x4(fours[c], fours[4 + c], 0xdd);
    const Lanes even_high = _mm512_shuffle_f32x4(fours[8 + c], fours[12 + c], 0x88);
    const Lanes odd_high = _mm512_shuffle_f32x4(fours[8 + c], fours[12 + c], 0xdd);
    rows[c] = _mm512_shuffle_f32x4(even_low, even_high, 0x88);
    rows[c + 4] = _mm512_shuffle_f32x4(odd_low, odd_high, 0x88);
    rows[c + 8] = _mm512_shuffle_f32x4(even_low, even_high, 0xdd);
    rows[c + 12] = _mm512_shuffle_f32x4(odd_low, odd_high, 0xdd);
  }
}
inline Lanes multiply(Lanes a, Lanes b) { return _mm512_mul_ps(a, b); }
inline Lanes divide(Lanes a, Lanes b) { return _mm512_div_ps(a, b); }
inline Lanes smaller(Lanes limit, Lanes x) { return _mm512_min_ps(limit, x); }
inline Lanes larger(Lanes limit, Lanes x) { return _mm512_max_ps(limit, x); }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return _mm512_fmadd_ps(a, b, c); }
#elif defined(__AVX2__)
using Lanes = __m256;
constexpr int kLanes = 8, kTileRows = 6, kTileColumns = 2;
inline Lanes load(const float* from) { return _mm256_loadu_ps(from); }
inline void store(float* to, Lanes a) { _mm256_storeu_ps(to, a); }
inline Lanes broadcast(float a) { return _mm256_set1_ps(a); }
inline Lanes add(Lanes a, Lanes b) { return _mm256_add_ps(a, b); }
inline Lanes subtract(Lanes a, Lanes b) { return _mm256_sub_ps(a, b); }
inline Lanes square_root(Lanes a) { return _mm256_sqrt_ps(a); }
using LaneMask = __m256;
inline LaneMask less(Lanes a, Lanes b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
inline LaneMask both(LaneMask a, LaneMask b) { return _mm256_and_ps(a, b); }
inline Lanes select(LaneMask m, Lanes a, Lanes b) { return _mm256_blendv_ps(b, a, m); }
inline unsigned bits_of(LaneMask m) { return static_cast<unsigned>(_mm256_movemask_ps(m)); }
inline Lanes gather(const float* from, const int* index) {
  return _mm256_i32gather_ps(from, _mm256_loadu_si256(reinterpret_cast<const __m256i*>(index)), 4);
}
inline void transpose_tile(Lanes* rows) {
  Lanes pairs[8], fours[8];
  for (int k = 0; k < 8; k += 2) {
    pairs[k] = _mm256_unpacklo_ps(rows[k], rows[k + 1]);
    pairs[k + 1] = _mm256_unpackhi_ps(rows[k], rows[k + 1]);
  }
  for (int k = 0; k < 8; k += 4) {
    for (int h = 0; h < 2; ++h) {
      fours[k + 2 * h] = _mm256_shuffle_ps(pairs[k + h], pairs[k + h + 2], 0x44);
      fours[k + 2 * h + 1] = _mm256_shuffle_ps(pairs[k + h], pairs[k + h + 2], 0xee);
    }
  }
  for (int c = 0; c < 4; ++c) {
    rows[c] = _mm256_permute2f128_ps(fours[c], fours[4 + c], 0x20);
    rows[c + 4] = _mm256_permute2f128_ps(fours[c], fours[4 + c], 0x31);
  }
}
inline Lanes multiply(Lanes a, Lanes b) { return _mm256_mul_ps(a, b); }
inline Lanes divide(Lanes a, Lanes b) { return _mm256_div_ps(a, b); }
inline Lanes smaller(Lanes limit, Lanes x) { return _mm256_min_ps(limit, x); }
inline Lanes larger(Lanes limit, Lanes x) { return _mm256_max_ps(limit, x); }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return _mm256_fmadd_ps(a, b, c); }
#elif defined(__SSE2__) || defined(_M_X64)
using Lanes = __m128;
constexpr int kLanes = 4, kTileRows = 3, kTileColumns = 4;
inline Lanes load(const float* from) { return _mm_loadu_ps(from); }
inline void store(float* to, Lanes a) { _mm_storeu_ps(to, a); }
inline Lanes broadcast(float a) { return _mm_set1_ps(a); }
inline Lanes add(Lanes a, Lanes b) { return _mm_add_ps(a, b); }
inline Lanes subtract(Lanes a, Lanes b) { return _mm_sub_ps(a, b); }
inline Lanes square_root(Lanes a) { return _mm_sqrt_ps(a); }
using LaneMask = __m128;
inline LaneMask less(Lanes a, Lanes b) { return _mm_cmplt_ps(a, b); }
inline LaneMask both(LaneMask a, LaneMask b) { return _mm_and_ps(a, b); }
inline Lanes select(LaneMask m, Lanes a, Lanes b) { return _mm_or_ps(_mm_and_ps(m, a), _mm_andnot_ps(m, b)); }
inline unsigned bits_of(LaneMask m) { return static_cast<unsigned>(_mm_movemask_ps(m)); }
inline Lanes gather(const float* from, const int* index) {
  return _mm_set_ps(from[index[3]], from[index[2]], from[index[1]], from[index[0]]);
}
inline void transpose_tile(Lanes* rows) { _MM_TRANSPOSE4_PS(rows[0], rows[1], rows[2], rows[3]); }
inline Lanes multiply(Lanes a, Lanes b) { return _mm_mul_ps(a, b); }
inline Lanes divide(Lanes a, Lanes b) { return _mm_div_ps(a, b); }
inline Lanes smaller(Lanes limit, Lanes x) { return _mm_min_ps(limit, x); }
inline Lanes larger(Lanes limit, Lanes x) { return _mm_max_ps(limit, x); }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return _mm_add_ps(_mm_mul_ps(a, b), c); }
#elif defined(__aarch64__) || defined(_M_ARM64)
using Lanes = float32x4_t;
constexpr int kLanes = 4, kTileRows = 6, kTileColumns = 4;
inline Lanes load(const float* from) { return vld1q_f32(from); }
inline void store(float* to, Lanes a) { vst1q_f32(to, a); }
inline Lanes broadcast(float a) { return vdupq_n_f32(a); }
inline Lanes add(Lanes a, Lanes b) { return vaddq_f32(a, b); }
inline Lanes subtract(Lanes a, Lanes b) { return vsubq_f32(a, b); }
inline Lanes square_root(Lanes a) { return vsqrtq_f32(a); }
using LaneMask = uint32x4_t;
inline LaneMask less(Lanes a, Lanes b) { return vcltq_f32(a, b); }
inline LaneMask both(LaneMask a, LaneMask b) { return vandq_u32(a, b); }
inline Lanes select(LaneMask m, Lanes a, Lanes b) { return vbslq_f32(m, a, b); }
inline unsigned bits_of(LaneMask m) {
  return (vgetq_lane_u32(m, 0) & 1u) | (vgetq_lane_u32(m, 1) & 2u) | (vgetq_lane_u32(m, 2) & 4u) | (vgetq_lane_u32(m, 3) & 8u);
}
inline Lanes gather(const float* from, const int* index) {
  const float values[4] = {from[index[0]], from[index[1]], from[index[2]], from[index[3]]};
  return vld1q_f32(values);
}
inline void transpose_tile(Lanes* rows) {
  const float32x4x2_t a = vtrnq_f32(rows[0], rows[1]), b = vtrnq_f32(rows[2], rows[3]);
  rows[0] = vcombine_f32(vget_low_f32(a.val[0]), vget_low_f32(b.val[0]));
  rows[1] = vcombine_f32(vget_low_f32(a.val[1]), vget_low_f32(b.val[1]));
  rows[2] = vcombine_f32(vget_high_f32(a.val[0]), vget_high_f32(b.val[0]));
  rows[3] = vcombine_f32(vget_high_f32(a.val[1]), vget_high_f32(b.val[1]));
}
inline Lanes multiply(Lanes a, Lanes b) { return vmulq_f32(a, b); }
inline Lanes divide(Lanes a, Lanes b) { return vdivq_f32(a, b); }
inline Lanes smaller(Lanes limit, Lanes x) { return vminq_f32(limit, x); }
inline Lanes larger(Lanes limit, Lanes x) { return vmaxq_f32(limit, x); }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return vfmaq_f32(c, a, b); }
#else
using Lanes = float;
constexpr int kLanes = 1, kTileRows = 1, kTileColumns = 16;
inline Lanes load(const float* from) { return *from; }
inline void store(float* to, Lanes a) { *to = a; }
inline Lanes broadcast(float a) { return a; }
inline Lanes add(Lanes a, Lanes b) { return a + b; }
inline Lanes subtract(Lanes a, Lanes b) { return a - b; }
inline Lanes square_root(Lanes a) { return sqrtf(a); }
using LaneMask = bool;
inline LaneMask less(Lanes a, Lanes b) { return a < b; }
inline LaneMask both(LaneMask a, LaneMask b) { return a && b; }
inline Lanes select(LaneMask m, Lanes a, Lanes b) { return m ? a : b; }
inline unsigned bits_of(LaneMask m) { return m ? 1u : 0u; }
inline Lanes gather(const float* from, const int* index) { return from[*index]; }
inline void transpose_tile(Lanes* /*rows*/) {}
inline Lanes multiply(Lanes a, Lanes b) { return a * b; }
inline Lanes divide(Lanes a, Lanes b) { return a / b; }
inline Lanes smaller(Lanes limit, Lanes x) { return limit < x ? limit : x; }
inline Lanes larger(Lanes limit, Lanes x) { return limit > x ? limit : x; }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return a * b + c; }
#endif

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
