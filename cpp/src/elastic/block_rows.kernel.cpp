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

inline Four load(const double* from) noexcept {
  Four four;
  __builtin_memcpy(&four, from, sizeof(four));
  return four;
}
#else
struct Four {
  double values[3];
  double operator[](int k) const noexcept { return values[k]; }
};
inline Four load(const double* from) noexcept { return {{from[0], from[1], from[2]}}; }
inline Four operator*(const Four& a, double s) noexcept { return {{a[0] * s, a[1] * s, a[2] * s}}; }
inline Four operator+(const Four& a, const Four& b) noexcept { return {{a[0] + b[0], a[1] + b[1], a[2] + b[2]}}; }
#endif

// Sum of blocks times the vectors of their columns.
inline Four row_sum(const double* blocks, const std::int32_t* columns, const double* x, std::int32_t first,
                    std::int32_t last) noexcept {
  const double zeros[4] = {0, 0, 0, 0};
  Four a = load(zeros), b = a, c = a;
  for (std::int32_t k = first; k < last; ++k) {
    const double* block = blocks + 9 * static_cast<std::int64_t>(k);
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

}  // namespace followthrough::FOLLOWTHROUGH_ISA
