// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A vertex's weighted sum of table rows, for kernel files only: everything here lives in the set's own namespace. Every number of
/// a row goes through the same operations in the same order whatever the width of a register, so all instruction sets give the same
/// bits.
#pragma once

#include "skinning/bone_rows.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

constexpr double largest = 1.7976931348623157e308;

// As many numbers of a row as a register holds; four at most, which divides every row.
#if defined(__GNUC__)
#if defined(__AVX__)
constexpr int lanes = 4;
#else
constexpr int lanes = 2;
#endif
using Lanes = double __attribute__((vector_size(8 * lanes)));
using LanesInMemory = double __attribute__((vector_size(8 * lanes), aligned(8), may_alias));

inline Lanes load(const double* place) { return *reinterpret_cast<const LanesInMemory*>(place); }
inline void store(double* place, Lanes values) { *reinterpret_cast<LanesInMemory*>(place) = values; }
#else
constexpr int lanes = 1;
using Lanes = double;

inline Lanes load(const double* place) { return *place; }
inline void store(double* place, Lanes value) { *place = value; }
#endif

template <int columns, bool quaternions>
inline double sum_rows(const BoneRows& rows, double* result, bool& valid) {
  constexpr int registers = columns / lanes;
  Lanes sum[registers] = {};
  double rotation[4] = {};  // of the sum so far
  double total = 0.0;
  for (std::int64_t place = 0; place < rows.places; ++place) {
    const double weight = rows.weights[place];
    if (weight == 0.0) continue;
    const std::int64_t index = rows.indices[place];
    if (!(weight > 0.0 && weight <= largest && index >= -1 && index < rows.bones)) {
      valid = false;
      continue;
    }
    const double* row = rows.table + (index < 0 ? rows.bones : index) * columns;
    double share = weight;
    if constexpr (quaternions) {
      const double side = (rotation[0] * row[0] + rotation[2] * row[2]) + (rotation[1] * row[1] + rotation[3] * row[3]);
      share = side < 0.0 ? -weight : weight;
      for (int k = 0; k < 4; ++k) rotation[k] += share * row[k];
    }
    for (int k = 0; k < registers; ++k) sum[k] += share * load(row + lanes * k);
    total += weight;
  }
  for (int k = 0; k < registers; ++k) store(result + lanes * k, sum[k]);
  return total;
}

}  // namespace

}  // namespace followthrough::FOLLOWTHROUGH_ISA
