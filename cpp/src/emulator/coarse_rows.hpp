// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A coarse system beside the diagonal blocks that a Newton pass's conjugate gradients are preconditioned with: rows of an
/// aggregate, 64 that follow each other, move as one, and so do those of a node, a part of 256 rows or several. Aggregates have
/// their diagonal blocks alone, nodes the whole system, factored. Both answers are added to the diagonal's.
///
/// Rows that follow each other should be close together. Interior tets, whose stiffness cancels out where an aggregate moves, are
/// left out instead of relying on that: a diagonal block is what is between it and others with its sign turned, and what holds the
/// rows beside constrained ones.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "elastic/block_matrix.hpp"
#include "elastic/sparse_cholesky.hpp"
#include "emulator/packed_layers.hpp"

namespace followthrough {

/// What the coarse system adds up of the rows' matrix. Each pair of free neighbours counts once, and so does each row with itself.
struct CoarseEntry {
  std::int32_t row, other;  ///< row <= other
  std::int32_t place;       ///< of the block in the tets' sums (newton_kernel.hpp)
  double mass;              ///< on the block's diagonal
};

class CoarseRows {
 public:
  /// Of both answers: the diagonal, aggregates and nodes each answer for all that moves as one.
  static constexpr double weight = 0.5;

  /// @param rows free ones
  /// @param part_groups groups of 16 rows in a part, whole aggregates
  /// @param held (rows,) those with a constrained neighbour
  /// @param most_nodes nodes have twice as many parts each until there are no more than so many
  CoarseRows(std::int32_t rows, std::int32_t part_groups, const std::vector<bool>& held, const std::vector<CoarseEntry>& entries,
             std::int32_t most_nodes = 96);

  /// Adds up what a part's rows have of the tets' sums. Parts may be added at the same time.
  void add_part(std::int32_t part, const float* sums);
  /// Makes the system of what all parts have added up: by one thread, and the others wait.
  void compute();
  /// (aggregates, 3) what kernels restrict the residual to.
  float* restricted() { return restricted_.data(); }
  /// (aggregates, 3) what kernels add to the preconditioned residual.
  const float* corrections() const { return corrections_.data(); }
  /// The answers of a part's aggregates, from `restricted`; at the same time, too.
  void correct_part(std::int32_t part);
  /// After all parts: the answers of the nodes, by one thread.
  void solve_nodes();
  /// After that: adds them to those of a part's aggregates; at the same time, too.
  void add_nodes(std::int32_t part);
  /// After solve_nodes: the residual times all answers.
  double slope() const { return slope_; }

  std::int32_t part_count() const { return static_cast<std::int32_t>(pair_starts_.size()) - 1; }
  std::int32_t aggregate_count() const { return aggregates_; }
  std::int32_t node_count() const { return nodes_; }

 private:
  struct PartPair {            // of different nodes
    std::int32_t part, other;  // part < other
    Index block, turned;       // places in the nodes' matrix, of the one way round and the other
    double mass;
  };

  std::int32_t first_aggregate(std::int32_t part) const;

  std::int32_t part_aggregates_, aggregates_, nodes_, parts_a_node_;
  std::vector<std::int32_t> pair_starts_, pair_places_;  // of each part: to, from
  std::vector<PartPair> part_pairs_;
  std::vector<double> aggregate_masses_, node_masses_;
  AlignedFloats blocks_;  // three an aggregate: own blocks of held rows, their other ones, those that leave it; then part pairs'
  std::vector<std::int32_t> part_blocks_;  // (parts + 1,) where those of its pairs start
  std::vector<float> inverse_;             // (aggregates, 9), weighted
  std::vector<float> restricted_, corrections_;
  std::vector<double> part_slopes_, part_sums_;
  std::vector<BlockMatrix::Block> sums_;  // of the nodes' matrix
  std::optional<BlockMatrix> matrix_;
  std::optional<SparseCholesky> factor_;
  Vector right_, left_;
  bool definite_ = false;
  double slope_ = 0;
};

}  // namespace followthrough
