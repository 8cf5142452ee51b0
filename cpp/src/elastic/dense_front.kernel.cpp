// SPDX-License-Identifier: GPL-3.0-or-later
// Every lane goes through the same operations in the same order, so all instruction sets give the same bits.
#include "elastic/dense_front.hpp"

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors wider than the registers never leave this file
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// Columns that are eliminated before the rest of the matrix hears of it; columns of the rest that are brought up to date at a time.
constexpr int panel_width = 24, tile_width = 6;

#if defined(__GNUC__) || defined(__clang__)
typedef float Lanes __attribute__((vector_size(sizeof(float) * front_lanes)));
inline Lanes load(const float* from) noexcept { return *reinterpret_cast<const Lanes*>(from); }
inline void store(const Lanes& value, float* to) noexcept { *reinterpret_cast<Lanes*>(to) = value; }
inline float total(const Lanes& v) noexcept {
  float sums[8];
  for (int k = 0; k < 8; ++k) sums[k] = v[k] + v[k + 8];
  for (int k = 0; k < 4; ++k) sums[k] += sums[k + 4];
  return (sums[0] + sums[2]) + (sums[1] + sums[3]);
}
#else
struct Lanes {
  float values[front_lanes];
};
inline Lanes load(const float* from) noexcept {
  Lanes r;
  for (int k = 0; k < front_lanes; ++k) r.values[k] = from[k];
  return r;
}
inline void store(const Lanes& value, float* to) noexcept {
  for (int k = 0; k < front_lanes; ++k) to[k] = value.values[k];
}
inline Lanes operator*(const Lanes& a, float s) noexcept {
  Lanes r;
  for (int k = 0; k < front_lanes; ++k) r.values[k] = a.values[k] * s;
  return r;
}
inline Lanes operator*(const Lanes& a, const Lanes& b) noexcept {
  Lanes r;
  for (int k = 0; k < front_lanes; ++k) r.values[k] = a.values[k] * b.values[k];
  return r;
}
inline Lanes operator-(const Lanes& a, const Lanes& b) noexcept {
  Lanes r;
  for (int k = 0; k < front_lanes; ++k) r.values[k] = a.values[k] - b.values[k];
  return r;
}
inline Lanes operator+(const Lanes& a, const Lanes& b) noexcept {
  Lanes r;
  for (int k = 0; k < front_lanes; ++k) r.values[k] = a.values[k] + b.values[k];
  return r;
}
inline float total(const Lanes& v) noexcept {
  float sums[8];
  for (int k = 0; k < 8; ++k) sums[k] = v.values[k] + v.values[k + 8];
  for (int k = 0; k < 4; ++k) sums[k] += sums[k + 4];
  return (sums[0] + sums[2]) + (sums[1] + sums[3]);
}
#endif

inline int floor_lanes(int row) noexcept { return row / front_lanes * front_lanes; }

inline float root(float value) noexcept { return __builtin_sqrtf(value); }

// Columns first...last of L, from which all earlier columns have been taken.
bool eliminate_panel(float* matrix, int stride, int first, int last, float smallest) noexcept {
  for (int j = first; j < last; ++j) {
    float* column = matrix + static_cast<long>(j) * stride;
    for (int row = floor_lanes(j); row < stride; row += front_lanes) {
      Lanes sum = load(column + row);
      for (int k = first; k < j; ++k) {
        const float* earlier = matrix + static_cast<long>(k) * stride;
        sum = sum - load(earlier + row) * earlier[j];
      }
      store(sum, column + row);
    }
    const float pivot = column[j];
    if (!(pivot > smallest)) return false;
    const float inverse = 1 / root(pivot);
    for (int row = floor_lanes(j); row < stride; row += front_lanes) store(load(column + row) * inverse, column + row);
    column[j] = root(pivot);
  }
  return true;
}

// Takes columns first...last of L from `Width` columns of the rest, from `column` on.
template <int Width>
inline void update_tile(float* matrix, int stride, int first, int last, int column) noexcept {
  for (int row = floor_lanes(column); row < stride; row += front_lanes) {
    Lanes sum[Width];
    float* to = matrix + static_cast<long>(column) * stride + row;
    for (int c = 0; c < Width; ++c) sum[c] = load(to + static_cast<long>(c) * stride);
    for (int k = first; k < last; ++k) {
      const float* l = matrix + static_cast<long>(k) * stride;
      const Lanes rows = load(l + row);
      for (int c = 0; c < Width; ++c) sum[c] = sum[c] - rows * l[column + c];
    }
    for (int c = 0; c < Width; ++c) store(sum[c], to + static_cast<long>(c) * stride);
  }
}

}  // namespace

bool eliminate(float* matrix, int stride, int rows, int pivots, float smallest) noexcept {
  for (int first = 0; first < pivots; first += panel_width) {
    const int last = first + panel_width < pivots ? first + panel_width : pivots;
    if (!eliminate_panel(matrix, stride, first, last, smallest)) return false;
    int column = last;
    for (; column + tile_width <= rows; column += tile_width) update_tile<tile_width>(matrix, stride, first, last, column);
    for (; column < rows; ++column) update_tile<1>(matrix, stride, first, last, column);
  }
  for (int j = 0; j < pivots; ++j) {
    float& diagonal = matrix[static_cast<long>(j) * stride + j];
    diagonal = 1 / diagonal;
  }
  return true;
}

void solve_lower(const float* panel, int stride, int pivots, float* x) noexcept {
  for (int j = 0; j < pivots; ++j) {
    const float* column = panel + static_cast<long>(j) * stride;
    const float value = x[j] * column[j];
    for (int row = floor_lanes(j); row < stride; row += front_lanes) store(load(x + row) - load(column + row) * value, x + row);
    // Rows above j were touched by the numbers above the diagonal, which are zero; row j itself is set here.
    x[j] = value;
  }
}

void solve_upper(const float* panel, int stride, int pivots, float* x) noexcept {
  for (int j = pivots; j-- > 0;) {
    const float* column = panel + static_cast<long>(j) * stride;
    Lanes sum = load(x + floor_lanes(j)) * load(column + floor_lanes(j));
    const float own = x[j] * column[j];
    for (int row = floor_lanes(j) + front_lanes; row < stride; row += front_lanes) sum = sum + load(x + row) * load(column + row);
    x[j] = (x[j] - (total(sum) - own)) * column[j];
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
