// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/block_matrix.hpp"

#include <algorithm>

#include "elastic/block_rows.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr Eigen::Index rows_at_a_time = 256;
constexpr double block_nanoseconds = 2.5;

decltype(&baseline::multiply_rows) multiply_rows_kernel() { return FOLLOWTHROUGH_KERNEL(multiply_rows); }

}  // namespace

BlockMatrix::BlockMatrix(const std::vector<std::array<Index, 4>>& corners, std::span<const Index> rows) {
  const Index row_count = rows.empty() ? 0 : std::max(*std::max_element(rows.begin(), rows.end()) + 1, 0);
  std::vector<std::vector<Index>> neighbours(static_cast<std::size_t>(row_count));
  for (Index row = 0; row < row_count; ++row) neighbours[row].push_back(row);
  for (const std::array<Index, 4>& tet : corners) {
    for (const Index a : tet) {
      if (rows[a] < 0) continue;
      for (const Index b : tet) {
        if (rows[b] >= 0) neighbours[rows[a]].push_back(rows[b]);
      }
    }
  }
  starts_.push_back(0);
  for (std::vector<Index>& columns : neighbours) {
    std::sort(columns.begin(), columns.end());
    columns.erase(std::unique(columns.begin(), columns.end()), columns.end());
    columns_.insert(columns_.end(), columns.begin(), columns.end());
    starts_.push_back(static_cast<Index>(columns_.size()));
  }
  const auto slot_of = [&](Index row, Index column) {
    const auto first = columns_.begin() + starts_[row], last = columns_.begin() + starts_[row + 1];
    return static_cast<Index>(std::lower_bound(first, last, column) - columns_.begin());
  };
  for (Index row = 0; row < row_count; ++row) diagonal_.push_back(slot_of(row, row));
  slots_.resize(corners.size());
  for (std::size_t tet = 0; tet < corners.size(); ++tet) {
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        const Index row = rows[corners[tet][a]], column = rows[corners[tet][b]];
        slots_[tet][4 * a + b] = row < 0 || column < 0 ? -1 : slot_of(row, column);
      }
    }
  }
  blocks_.assign(columns_.size() + 1, Block::Zero());
}

void BlockMatrix::multiply(const double* x, double* y) const {
  const auto kernel = multiply_rows_kernel();
  const Eigen::Index chunks = (row_count() + rows_at_a_time - 1) / rows_at_a_time;
  const int threads = worthwhile_threads(static_cast<std::ptrdiff_t>(columns_.size()), block_nanoseconds);
#pragma omp parallel for schedule(static) num_threads(threads)
  for (Eigen::Index chunk = 0; chunk < chunks; ++chunk) {
    const auto first = static_cast<Index>(chunk * rows_at_a_time);
    const auto last = static_cast<Index>(std::min((chunk + 1) * rows_at_a_time, row_count()));
    kernel({starts_.data(), columns_.data(), blocks_.front().data()}, x, y, first, last);
  }
}

}  // namespace followthrough
