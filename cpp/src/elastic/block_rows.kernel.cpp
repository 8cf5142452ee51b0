// SPDX-License-Identifier: GPL-3.0-or-later
// A block's column and one number too many make four lanes; the fourth is never looked at. Every number goes through the same
// operations in the same order, so all instruction sets give the same bits.
#include "elastic/block_rows.hpp"

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors wider than the registers never leave this file
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

#if defined(__GNUC__) || defined(__clang__)
typedef double Four __attribute__((vector_size(4 * sizeof(double))));
typedef float FourSingle __attribute__((vector_size(4 * sizeof(float))));

inline Four load(const double* from) noexcept {
  Four four;
  __builtin_memcpy(&four, from, sizeof(four));
  return four;
}
inline Four load(const float* from) noexcept {
  FourSingle four;
  __builtin_memcpy(&four, from, sizeof(four));
  return __builtin_convertvector(four, Four);
}
#else
struct Four {
  double values[3];
  double operator[](int k) const noexcept { return values[k]; }
};
template <typename Number>
inline Four load(const Number* from) noexcept {
  return {{from[0], from[1], from[2]}};
}
inline Four operator*(const Four& a, double s) noexcept { return {{a[0] * s, a[1] * s, a[2] * s}}; }
inline Four operator+(const Four& a, const Four& b) noexcept { return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}}; }
inline Four operator-(const Four& a, const Four& b) noexcept { return {{a[0] - b[0], a[1] - b[1], a[2] - b[2]}}; }
#endif

template <typename Number>
inline Four product(const Number* block, const double* v) noexcept {
  return load(block) * v[0] + load(block + 3) * v[1] + load(block + 6) * v[2];
}

// Sum of blocks times the vectors of their columns.
template <typename Number>
inline Four row_sum(const Number* blocks, const std::int32_t* columns, const double* x, std::int32_t first,
                    std::int32_t last) noexcept {
  const double zeros[4] = {0, 0, 0, 0};
  Four a = load(zeros), b = a, c = a;
  for (std::int32_t k = first; k < last; ++k) {
    const Number* block = blocks + 9 * static_cast<std::int64_t>(k);
    const double* v = x + 3 * static_cast<std::int64_t>(columns[k]);
    a = a + load(block) * v[0];
    b = b + load(block + 3) * v[1];
    c = c + load(block + 6) * v[2];
  }
  return a + b + c;
}

inline void store(const Four& four, double* to) noexcept {
  to[0] = four[0];
  to[1] = four[1];
  to[2] = four[2];
}

}  // namespace

void multiply_rows(const BlockRows& matrix, const double* x, double* y, std::int32_t first, std::int32_t last) noexcept {
  for (std::int32_t row = first; row < last; ++row) {
    store(row_sum(matrix.blocks, matrix.columns, x, matrix.starts[row], matrix.starts[row + 1]),
          y + 3 * static_cast<std::int64_t>(row));
  }
}

void solve_rows(const TriangularRows& factor, double scale, const double* r, double* z, std::int32_t first,
                std::int32_t last) noexcept {
  for (std::int32_t row = first; row < last; ++row) {
    const std::int64_t at = 3 * static_cast<std::int64_t>(row);
    const double right[4] = {scale * r[at], scale * r[at + 1], scale * r[at + 2], 0};
    double sum[3];
    store(load(right) - row_sum(factor.blocks, factor.columns, z, factor.lower[row], factor.diagonal[row]), sum);
    store(product(factor.inverse_diagonal + 3 * at, sum), z + at);
  }
  for (std::int32_t row = last; row-- > first;) {
    const std::int64_t at = 3 * static_cast<std::int64_t>(row);
    double sum[3], change[3];
    store(row_sum(factor.blocks, factor.columns, z, factor.diagonal[row] + 1, factor.upper[row]), sum);
    store(product(factor.inverse_diagonal + 3 * at, sum), change);
    for (int k = 0; k < 3; ++k) z[at + k] -= change[k];
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
