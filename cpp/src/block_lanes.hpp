// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Numbers in memory that are not floats lane by lane, for kernel files only: vectors of four floats, x y z and one that nobody
/// needs, and blocks of nine, which may start anywhere; and numbers between -1 and 1 in 16 bits.
#pragma once

#include <cstdint>

#include "lane_algebra.hpp"
#include "lanes.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

/// to[k] += from[k] for nine floats, and no other is read or written: a processor forwards what it has just stored only to a load
/// of the same bytes, and blocks that lie side by side follow each other closely.
inline void add_block(float* to, const float* from) {
#if defined(__AVX512F__)
  _mm256_storeu_ps(to, _mm256_add_ps(_mm256_loadu_ps(to), _mm256_loadu_ps(from)));
#else
  for (int k = 0; k < 8; k += kLanes) store(to + k, add(load(to + k), load(from + k)));
#endif
  to[8] += from[8];
}

/// Adds a group's blocks: nine[k][lane] is number k of the one that goes to to + places[lane]. In whatever order the lanes
/// come, it is the same with every instruction set.
inline void add_group_of_blocks(const float (*nine)[kGroup], float* to, const std::int32_t* places) {
#if defined(__AVX512F__)
  __m512d fours[8];  // fours[4 q + c] has lane c + 4 p of the numbers 4 q to 4 q + 3 in its quarter p
  for (int k = 0; k < 8; k += 4) {
    const __m512 a = load(nine[k]), b = load(nine[k + 1]), c = load(nine[k + 2]), d = load(nine[k + 3]);
    const __m512d ab[2] = {_mm512_castps_pd(_mm512_unpacklo_ps(a, b)), _mm512_castps_pd(_mm512_unpackhi_ps(a, b))};
    const __m512d cd[2] = {_mm512_castps_pd(_mm512_unpacklo_ps(c, d)), _mm512_castps_pd(_mm512_unpackhi_ps(c, d))};
    for (int h = 0; h < 2; ++h) {
      fours[k + 2 * h] = _mm512_unpacklo_pd(ab[h], cd[h]);
      fours[k + 2 * h + 1] = _mm512_unpackhi_pd(ab[h], cd[h]);
    }
  }
  const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 2, 3, 10, 11), high = _mm512_setr_epi64(4, 5, 12, 13, 6, 7, 14, 15);
  for (int c = 0; c < 4; ++c) {
    const __m512 two[2] = {_mm512_castpd_ps(_mm512_permutex2var_pd(fours[c], low, fours[4 + c])),
                           _mm512_castpd_ps(_mm512_permutex2var_pd(fours[c], high, fours[4 + c]))};
    for (int p = 0; p < 4; ++p) {
      const int lane = c + 4 * p;
      const __m256 eight = p % 2 ? _mm512_extractf32x8_ps(two[p / 2], 1) : _mm512_castps512_ps256(two[p / 2]);
      float* const there = to + places[lane];
      _mm256_storeu_ps(there, _mm256_add_ps(_mm256_loadu_ps(there), eight));
      there[8] += nine[8][lane];
    }
  }
#else
  float blocks[kGroup][9];
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    for (int k = 0; k < 8; k += kLanes) {
      Lanes tile[kLanes];
      for (int row = 0; row < kLanes; ++row) tile[row] = load(nine[k + row] + lane);
      transpose_tile(tile);
      for (int row = 0; row < kLanes; ++row) store(blocks[lane + row] + k, tile[row]);
    }
  }
  for (int lane = 0; lane < kGroup; ++lane) blocks[lane][8] = nine[8][lane];
  for (int c = 0; c < 4; ++c) {
    for (int lane = c; lane < kGroup; lane += 4) add_block(to + places[lane], blocks[lane]);
  }
#endif
}

/// Components of the vectors that start at from + starts[lane].
inline void load_vectors(const float* from, const int* starts, Lanes (&components)[3]) {
#if defined(__AVX512F__)
  __m512 rows[4];  // rows[k] has the vectors k, 4 + k, 8 + k, 12 + k
  for (int k = 0; k < 4; ++k) {
    rows[k] = _mm512_castps128_ps512(_mm_loadu_ps(from + starts[k]));
    rows[k] = _mm512_insertf32x4(rows[k], _mm_loadu_ps(from + starts[4 + k]), 1);
    rows[k] = _mm512_insertf32x4(rows[k], _mm_loadu_ps(from + starts[8 + k]), 2);
    rows[k] = _mm512_insertf32x4(rows[k], _mm_loadu_ps(from + starts[12 + k]), 3);
  }
  const __m512d xy01 = _mm512_castps_pd(_mm512_unpacklo_ps(rows[0], rows[1]));
  const __m512d xy23 = _mm512_castps_pd(_mm512_unpacklo_ps(rows[2], rows[3]));
  const __m512d z01 = _mm512_castps_pd(_mm512_unpackhi_ps(rows[0], rows[1]));
  const __m512d z23 = _mm512_castps_pd(_mm512_unpackhi_ps(rows[2], rows[3]));
  components[0] = _mm512_castpd_ps(_mm512_unpacklo_pd(xy01, xy23));
  components[1] = _mm512_castpd_ps(_mm512_unpackhi_pd(xy01, xy23));
  components[2] = _mm512_castpd_ps(_mm512_unpacklo_pd(z01, z23));
#elif defined(__AVX2__)
  __m256 rows[4];  // rows[k] has the vectors k and 4 + k
  for (int k = 0; k < 4; ++k) {
    rows[k] = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(from + starts[k])), _mm_loadu_ps(from + starts[4 + k]), 1);
  }
  const __m256d xy01 = _mm256_castps_pd(_mm256_unpacklo_ps(rows[0], rows[1]));
  const __m256d xy23 = _mm256_castps_pd(_mm256_unpacklo_ps(rows[2], rows[3]));
  const __m256d z01 = _mm256_castps_pd(_mm256_unpackhi_ps(rows[0], rows[1]));
  const __m256d z23 = _mm256_castps_pd(_mm256_unpackhi_ps(rows[2], rows[3]));
  components[0] = _mm256_castpd_ps(_mm256_unpacklo_pd(xy01, xy23));
  components[1] = _mm256_castpd_ps(_mm256_unpackhi_pd(xy01, xy23));
  components[2] = _mm256_castpd_ps(_mm256_unpacklo_pd(z01, z23));
#else
  if constexpr (kLanes == 4) {
    Lanes rows[4];
    for (int k = 0; k < 4; ++k) rows[k] = load(from + starts[k]);
    transpose_tile(rows);
    for (int c = 0; c < 3; ++c) components[c] = rows[c];
  } else {
    for (int c = 0; c < 3; ++c) components[c] = gather(from + c, starts);
  }
#endif
}

/// Vectors that lie one after the other.
inline void load_vectors(const float* from, Lanes (&components)[3]) {
  int starts[kLanes];
  for (int k = 0; k < kLanes; ++k) starts[k] = 4 * k;
  load_vectors(from, starts, components);
}

inline void store_vectors(float* to, const Lanes (&components)[3]) {
#if defined(__AVX512F__)
  const __m512 zero = _mm512_setzero_ps();
  const __m512d xy01 = _mm512_castps_pd(_mm512_unpacklo_ps(components[0], components[1]));
  const __m512d xy23 = _mm512_castps_pd(_mm512_unpackhi_ps(components[0], components[1]));
  const __m512d z01 = _mm512_castps_pd(_mm512_unpacklo_ps(components[2], zero));
  const __m512d z23 = _mm512_castps_pd(_mm512_unpackhi_ps(components[2], zero));
  const __m512 rows[4] = {_mm512_castpd_ps(_mm512_unpacklo_pd(xy01, z01)), _mm512_castpd_ps(_mm512_unpackhi_pd(xy01, z01)),
                          _mm512_castpd_ps(_mm512_unpacklo_pd(xy23, z23)), _mm512_castpd_ps(_mm512_unpackhi_pd(xy23, z23))};
  for (int k = 0; k < 4; ++k) {
    _mm_storeu_ps(to + 4 * k, _mm512_castps512_ps128(rows[k]));
    _mm_storeu_ps(to + 4 * (4 + k), _mm512_extractf32x4_ps(rows[k], 1));
    _mm_storeu_ps(to + 4 * (8 + k), _mm512_extractf32x4_ps(rows[k], 2));
    _mm_storeu_ps(to + 4 * (12 + k), _mm512_extractf32x4_ps(rows[k], 3));
  }
#elif defined(__AVX2__)
  const __m256 zero = _mm256_setzero_ps();
  const __m256d xy01 = _mm256_castps_pd(_mm256_unpacklo_ps(components[0], components[1]));
  const __m256d xy23 = _mm256_castps_pd(_mm256_unpackhi_ps(components[0], components[1]));
  const __m256d z01 = _mm256_castps_pd(_mm256_unpacklo_ps(components[2], zero));
  const __m256d z23 = _mm256_castps_pd(_mm256_unpackhi_ps(components[2], zero));
  const __m256 rows[4] = {_mm256_castpd_ps(_mm256_unpacklo_pd(xy01, z01)), _mm256_castpd_ps(_mm256_unpackhi_pd(xy01, z01)),
                          _mm256_castpd_ps(_mm256_unpacklo_pd(xy23, z23)), _mm256_castpd_ps(_mm256_unpackhi_pd(xy23, z23))};
  for (int k = 0; k < 4; ++k) {
    _mm_storeu_ps(to + 4 * k, _mm256_castps256_ps128(rows[k]));
    _mm_storeu_ps(to + 4 * (4 + k), _mm256_extractf128_ps(rows[k], 1));
  }
#else
  if constexpr (kLanes == 4) {
    Lanes rows[4] = {components[0], components[1], components[2], broadcast(0.0f)};
    transpose_tile(rows);
    for (int k = 0; k < 4; ++k) store(to + 4 * k, rows[k]);
  } else {
    for (int c = 0; c < 3; ++c) store(to + c, components[c]);
  }
#endif
}

/// Of vectors of three doubles, those of `ends` less those of `origins`, rounded. A fourth double after each is read, where it is
/// quicker, and means nothing.
inline Triple difference_of_triples(const double* vectors, const int* origins, const int* ends) {
#if defined(__AVX512F__) || defined(__AVX2__)
  const auto edge = [&](int lane) {
    const double *origin = vectors + 3 * std::int64_t{origins[lane]}, *end = vectors + 3 * std::int64_t{ends[lane]};
    return _mm256_cvtpd_ps(_mm256_sub_pd(_mm256_loadu_pd(end), _mm256_loadu_pd(origin)));
  };
  float vectors_of_four[4 * kLanes];
  for (int lane = 0; lane < kLanes; ++lane) _mm_storeu_ps(vectors_of_four + 4 * lane, edge(lane));
  Lanes components[3];
  load_vectors(vectors_of_four, components);
  return {{components[0]}, {components[1]}, {components[2]}};
#else
  float components[3][kLanes];
  for (int lane = 0; lane < kLanes; ++lane) {
    const double *origin = vectors + 3 * std::int64_t{origins[lane]}, *end = vectors + 3 * std::int64_t{ends[lane]};
    for (int k = 0; k < 3; ++k) components[k][lane] = static_cast<float>(end[k] - origin[k]);
  }
  return {load_real(components[0]), load_real(components[1]), load_real(components[2])};
#endif
}

inline Triple gather_triple(const float* from, const int* starts) {
  Lanes components[3];
  load_vectors(from, starts, components);
  return {{components[0]}, {components[1]}, {components[2]}};
}
inline Triple load_triple(const float* from) {
  Lanes components[3];
  load_vectors(from, components);
  return {{components[0]}, {components[1]}, {components[2]}};
}
inline void store(float* to, Triple a) { store_vectors(to, {a.x.v, a.y.v, a.z.v}); }

/// What 1 is in memory.
template <typename Stored>
constexpr float kOne = 1.0f;
template <>
constexpr float kOne<std::int16_t> = 32767.0f;

inline Lanes load_numbers(const float* from) { return load(from); }
inline void store_numbers(float* to, Lanes a) { store(to, a); }

#if defined(__AVX512F__)
inline Lanes load_numbers(const std::int16_t* from) {
  return _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(from))));
}
/// Rounded to the nearest, or even, and no farther than 16 bits go.
inline void store_numbers(std::int16_t* to, Lanes a) {
  _mm256_storeu_si256(reinterpret_cast<__m256i*>(to), _mm512_cvtsepi32_epi16(_mm512_cvtps_epi32(a)));
}
#elif defined(__AVX2__)
inline Lanes load_numbers(const std::int16_t* from) {
  return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(_mm_loadu_si128(reinterpret_cast<const __m128i*>(from))));
}
inline void store_numbers(std::int16_t* to, Lanes a) {
  const __m256i whole = _mm256_cvtps_epi32(a);
  _mm_storeu_si128(reinterpret_cast<__m128i*>(to),
                   _mm_packs_epi32(_mm256_castsi256_si128(whole), _mm256_extracti128_si256(whole, 1)));
}
#elif defined(__SSE2__) || defined(_M_X64)
inline Lanes load_numbers(const std::int16_t* from) {
  return _mm_cvtepi32_ps(_mm_cvtepi16_epi32(_mm_loadl_epi64(reinterpret_cast<const __m128i*>(from))));
}
inline void store_numbers(std::int16_t* to, Lanes a) {
  const __m128i whole = _mm_cvtps_epi32(a);
  _mm_storel_epi64(reinterpret_cast<__m128i*>(to), _mm_packs_epi32(whole, whole));
}
#elif defined(__aarch64__) || defined(_M_ARM64)
inline Lanes load_numbers(const std::int16_t* from) { return vcvtq_f32_s32(vmovl_s16(vld1_s16(from))); }
inline void store_numbers(std::int16_t* to, Lanes a) { vst1_s16(to, vqmovn_s32(vcvtnq_s32_f32(a))); }
#else
inline Lanes load_numbers(const std::int16_t* from) { return static_cast<float>(*from); }
inline void store_numbers(std::int16_t* to, Lanes a) {
  *to = static_cast<std::int16_t>(a > -kOne<std::int16_t> ? rintf(a < kOne<std::int16_t> ? a : kOne<std::int16_t>)
                                                          : -kOne<std::int16_t>);
}
#endif

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
