// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A register of floats under one name for every instruction set, for kernel files only: everything here lives in the set's own
/// namespace, so that the linker cannot mix them.
#pragma once

#if defined(__AVX2__) || defined(__SSE2__) || defined(_M_X64)
#include <immintrin.h>
#elif defined(__aarch64__) || defined(_M_ARM64)
#include <arm_neon.h>
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// multiply_add(a, b, c) is a b + c, rounded once where the set can. smaller(limit, x) and larger(limit, x) keep x where it is NaN.
// kTileRows x kTileColumns registers hold the sums of a tile and leave a few for what goes into them.
#if defined(__AVX512F__)
using Lanes = __m512;
constexpr int kLanes = 16, kTileRows = 12, kTileColumns = 2;
inline Lanes load(const float* from) { return _mm512_loadu_ps(from); }
inline void store(float* to, Lanes a) { _mm512_storeu_ps(to, a); }
inline Lanes broadcast(float a) { return _mm512_set1_ps(a); }
inline Lanes add(Lanes a, Lanes b) { return _mm512_add_ps(a, b); }
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
inline Lanes multiply(Lanes a, Lanes b) { return a * b; }
inline Lanes divide(Lanes a, Lanes b) { return a / b; }
inline Lanes smaller(Lanes limit, Lanes x) { return limit < x ? limit : x; }
inline Lanes larger(Lanes limit, Lanes x) { return limit > x ? limit : x; }
inline Lanes multiply_add(Lanes a, Lanes b, Lanes c) { return a * b + c; }
#endif

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
