// SPDX-License-Identifier: GPL-3.0-or-later
// Sparse symmetric matrix of 3x3 blocks over the free vertices of a tet mesh, stored row by row with both halves.
#pragma once

#include <algorithm>
#include <array>
#include <span>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

class BlockMatrix {
 public:
  using Block = Eigen::Matrix3d;

  /// @param corners tets
  /// @param rows (n,) row of every vertex; -1: none
  BlockMatrix(const std::vector<std::array<Index, 4>>& corners, std::span<const Index> rows);

  Eigen::Index row_count() const { return static_cast<Eigen::Index>(starts_.size()) - 1; }
  /// Takes the values of another one of the same pattern.
  void copy_values(const BlockMatrix& other) { blocks_ = other.blocks_; }
  void set_zero() { std::fill(blocks_.begin(), blocks_.end(), Block::Zero()); }

  /// Adds `block` at corner a's row, corner b's column of a tet, and its transpose at b, a. Corners without a row are left out.
  void add(std::size_t tet, int a, int b, const Block& block) {
    const Index slot = slots_[tet][4 * a + b];
    if (slot < 0) return;
    blocks_[slot] += block;
    if (a != b) blocks_[slots_[tet][4 * b + a]] += block.transpose();
  }
  /// @param other of the same pattern
  void add(const BlockMatrix& other) {
    for (std::size_t k = 0; k < blocks_.size(); ++k) blocks_[k] += other.blocks_[k];
  }
  /// @param k place in blocks()
  void set(Index k, const Block& block) { blocks_[k] = block; }
  void add_to_diagonal(Eigen::Index row, const Block& block) { blocks_[diagonal_[row]] += block; }

  /// y = this * x; both 3 numbers a row.
  void multiply(const double* x, double* y) const;

  /// @return place in blocks() of a tet's corner a's row, corner b's column; -1: none
  Index slot(std::size_t tet, int a, int b) const { return slots_[tet][4 * a + b]; }
  const std::vector<Index>& starts() const { return starts_; }
  const std::vector<Index>& columns() const { return columns_; }  ///< ascending in every row
  const std::vector<Index>& diagonal() const { return diagonal_; }
  const std::vector<Block>& blocks() const { return blocks_; }  ///< and one more, which kernels may read and nobody uses

 private:
  std::vector<Index> starts_, columns_, diagonal_;
  std::vector<std::array<Index, 16>> slots_;
  std::vector<Block> blocks_;
};

}  // namespace followthrough
