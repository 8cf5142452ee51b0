// SPDX-License-Identifier: GPL-3.0-or-later
// A block's column and one number too many make four lanes; the fourth is never looked at. Every number goes through the same
// operations in the same order, so all instruction sets give the same bits.
#include "elastic/block_rows.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

#if defined(__GNUC__) || defined(__clang__)
template <typename Number>
struct Lanes {
  typedef Number Four __attribute__((vector_size(4 * sizeof(Number))));
};
template <typename Number>
using Four = typename Lanes<Number>::Four;

template <typename Number>
inline Four<Number> load(const Number* from) noexcept {
  Four<Number> four;
  __builtin_memcpy(&four, from, sizeof(four));
  return four;
}
#else
template <typename Number>
struct Four {
  Number values[4];
  Number operator[](int k) const noexcept { return values[k]; }
};
template <typename Number>
inline Four<Number> load(const Number* from) noexcept {
  return {from[0], from[1], from[2], 0};
}
template <typename Number>
inline Four<Number> operator*(const Four<Number>& a, Number s) noexcept {
  return {a[0] * s, a[1] * s, a[2] * s, 0};
}
template <typename Number>
inline Four<Number> operator+(const Four<Number>& a, const Four<Number>& b) noexcept {
  return {a[0] + b[0], a[1] + b[1], a[2] + b[2], 0};
}
template <typename Number>
inline Four<Number> operator-(const Four<Number>& a, const Four<Number>& b) noexcept {
  return {a[0] - b[0], a[1] - b[1], a[2] - b[2], 0};
}
#endif

// Sum of blocks times the vectors of their columns, `stride` numbers each.
template <typename Number>
inline Four<Number> row_sum(const Number* blocks, const std::int32_t* columns, const Number* x, int stride, std::int32_t first,
                            std::int32_t last) noexcept {
  const Number zeros[4] = {0, 0, 0, 0};
  Four<Number> a = load(zeros), b = a, c = a;
  for (std::int32_t k = first; k < last; ++k) {
    const Number* block = blocks + 9 * static_cast<std::int64_t>(k);
    const Number* v = x + static_cast<std::int64_t>(stride) * columns[k];
    a = a + load(block) * v[0];
    b = b + load(block + 3) * v[1];
    c = c + load(block + 6) * v[2];
  }
  return a + b + c;
}

}  // namespace

void multiply_rows(const BlockRows& matrix, const double* x, double* y, std::int32_t first, std::int32_t last) noexcept {
  for (std::int32_t row = first; row < last; ++row) {
    const Four<double> sum = row_sum(matrix.blocks, matrix.columns, x, 3, matrix.starts[row], matrix.starts[row + 1]);
    double* to = y + 3 * static_cast<std::int64_t>(row);
    to[0] = sum[0];
    to[1] = sum[1];
    to[2] = sum[2];
  }
}

void solve_rows(const TriangularRows& factor, double scale, const double* r, double unscale, double* z, float* work,
                std::int32_t first, std::int32_t last) noexcept {
  for (std::int32_t row = first; row < last; ++row) {
    const double* from = r + 3 * static_cast<std::int64_t>(row);
    const float right[4] = {static_cast<float>(scale * from[0]), static_cast<float>(scale * from[1]),
                            static_cast<float>(scale * from[2]), 0};
    const Four<float> sum =
        load(right) - row_sum(factor.blocks, factor.columns, work, 4, factor.lower[row], factor.diagonal[row]);
    const float* inverse = factor.inverse_diagonal + 9 * static_cast<std::int64_t>(row);
    const Four<float> x = load(inverse) * sum[0] + load(inverse + 3) * sum[1] + load(inverse + 6) * sum[2];
    float* to = work + 4 * static_cast<std::int64_t>(row);
    to[0] = x[0];
    to[1] = x[1];
    to[2] = x[2];
  }
  for (std::int32_t row = last; row-- > first;) {
    const Four<float> sum = row_sum(factor.blocks, factor.columns, work, 4, factor.diagonal[row] + 1, factor.upper[row]);
    const float* inverse = factor.inverse_diagonal + 9 * static_cast<std::int64_t>(row);
    const Four<float> x = load(inverse) * sum[0] + load(inverse + 3) * sum[1] + load(inverse + 6) * sum[2];
    float* at = work + 4 * static_cast<std::int64_t>(row);
    double* to = z + 3 * static_cast<std::int64_t>(row);
    for (int k = 0; k < 3; ++k) {
      at[k] -= x[k];
      to[k] = unscale * static_cast<double>(at[k]);
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
