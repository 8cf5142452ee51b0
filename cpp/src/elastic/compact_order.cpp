// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/compact_order.hpp"

#include <algorithm>
#include <span>

namespace followthrough {
namespace {

void halve(ConstPositions positions, std::ptrdiff_t smallest, std::ptrdiff_t largest, std::span<Index> vertices) {
  const auto count = static_cast<std::ptrdiff_t>(vertices.size());
  if (count <= smallest) return;
  Eigen::RowVector3d low = positions.row(vertices[0]), high = low;
  for (const Index v : vertices) {
    low = low.cwiseMin(positions.row(v));
    high = high.cwiseMax(positions.row(v));
  }
  int axis = 0;
  (high - low).maxCoeff(&axis);
  // The first half is whole runs, so that only the last one of all is short.
  std::ptrdiff_t run = largest;
  while (run >= count) run /= 2;
  const std::ptrdiff_t middle = std::max((count / 2 + run / 2) / run, std::ptrdiff_t{1}) * run;
  std::nth_element(vertices.begin(), vertices.begin() + middle, vertices.end(),
                   [&](Index a, Index b) { return std::pair(positions(a, axis), a) < std::pair(positions(b, axis), b); });
  halve(positions, smallest, largest, vertices.first(middle));
  halve(positions, smallest, largest, vertices.subspan(middle));
}

}  // namespace

void order_compactly(ConstPositions positions, std::ptrdiff_t smallest, std::ptrdiff_t largest, std::vector<Index>& vertices) {
  halve(positions, smallest, largest, vertices);
}

}  // namespace followthrough
