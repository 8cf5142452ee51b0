// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/coarse_rows.hpp"

#include <algorithm>
#include <array>
#include <cstddef>
#include <map>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "aggregates.hpp"
#include "emulator/newton_kernel.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

using Block = BlockMatrix::Block;
using RowBlock = Eigen::Matrix<float, 3, 3, Eigen::RowMajor>;

std::size_t size(std::int64_t count) { return static_cast<std::size_t>(count); }

Block block_at(const float* from) { return Eigen::Map<const RowBlock>(from).cast<double>(); }

Block symmetric_part(const Block& block) { return 0.5 * (block + block.transpose()); }

// xx yy zz xy xz yz
Block own_block_at(const float* from) {
  Block block;
  block << from[0], from[3], from[4], from[3], from[1], from[5], from[4], from[5], from[2];
  return block;
}

}  // namespace

CoarseRows::CoarseRows(std::int32_t rows, std::int32_t part_groups, const std::vector<bool>& held,
                       const std::vector<CoarseEntry>& entries, std::int32_t most_nodes)
    : part_aggregates_(part_groups / aggregate_groups) {
  const std::int32_t aggregate_rows = aggregate_groups * kNewtonGroup, part_rows = part_groups * kNewtonGroup;
  const std::int32_t parts = (rows + part_rows - 1) / part_rows;
  aggregates_ = (rows + aggregate_rows - 1) / aggregate_rows;
  parts_a_node_ = 1;
  while ((parts + parts_a_node_ - 1) / parts_a_node_ > most_nodes) parts_a_node_ *= 2;
  nodes_ = (parts + parts_a_node_ - 1) / parts_a_node_;
  const auto node_of = [&](std::int32_t part) { return part / parts_a_node_; };

  // Pairs of parts, and of nodes.
  std::map<std::pair<std::int32_t, std::int32_t>, double> pair_masses;
  aggregate_masses_.assign(size(aggregates_), 0.0);
  node_masses_.assign(size(nodes_), 0.0);
  std::vector<std::array<Index, 4>> node_pairs;
  for (const CoarseEntry& entry : entries) {
    const std::int32_t part = entry.row / part_rows, other = entry.other / part_rows;
    const double mass = entry.row == entry.other ? entry.mass : 2.0 * entry.mass;  // either way round
    if (entry.row / aggregate_rows == entry.other / aggregate_rows) aggregate_masses_[size(entry.row / aggregate_rows)] += mass;
    if (node_of(part) == node_of(other)) {
      node_masses_[size(node_of(part))] += mass;
    } else {
      node_pairs.push_back({node_of(part), node_of(other), node_of(other), node_of(other)});
      pair_masses[{part, other}] += entry.mass;
    }
  }
  std::sort(node_pairs.begin(), node_pairs.end());
  node_pairs.erase(std::unique(node_pairs.begin(), node_pairs.end()), node_pairs.end());
  std::vector<Index> all(size(nodes_));
  for (std::int32_t node = 0; node < nodes_; ++node) all[size(node)] = node;
  matrix_.emplace(node_pairs, all);
  const auto place_of = [&](std::int32_t node, std::int32_t other) {
    const auto first = matrix_->columns().begin() + matrix_->starts()[node],
               last = matrix_->columns().begin() + matrix_->starts()[node + 1];
    return static_cast<Index>(std::lower_bound(first, last, other) - matrix_->columns().begin());
  };
  for (const auto& [pair, mass] : pair_masses) {
    const std::int32_t node = node_of(pair.first), other = node_of(pair.second);
    part_pairs_.push_back({pair.first, pair.second, place_of(node, other), place_of(other, node), mass});
  }

  // What each part adds up, one entry after the other.
  std::vector<std::vector<std::pair<std::int32_t, std::int32_t>>> lists(size(parts));
  const std::int32_t first_pair = 3 * aggregates_;
  const auto add_row = [&](std::int32_t row, std::int32_t other, std::int32_t place) {
    const std::int32_t aggregate = row / aggregate_rows;
    auto& list = lists[size(row / part_rows)];
    const bool own = row == other;
    if (held[size(row)]) list.emplace_back(kBlock * (3 * aggregate + (own ? 0 : 1)), place);
    if (other / aggregate_rows != aggregate) list.emplace_back(kBlock * (3 * aggregate + 2), place);
  };
  for (const CoarseEntry& entry : entries) {
    add_row(entry.row, entry.other, entry.place);
    if (entry.row == entry.other) continue;
    add_row(entry.other, entry.row, entry.place);
    const std::int32_t part = entry.row / part_rows, other = entry.other / part_rows;
    if (node_of(part) == node_of(other)) continue;
    const auto found = std::lower_bound(part_pairs_.begin(), part_pairs_.end(), std::pair(part, other),
                                        [](const PartPair& a, const auto& b) { return std::pair(a.part, a.other) < b; });
    lists[size(part)].emplace_back(kBlock * (first_pair + static_cast<std::int32_t>(found - part_pairs_.begin())), entry.place);
  }
  pair_starts_.assign(1, 0);
  for (const auto& list : lists) {
    for (const auto& [to, from] : list) {
      pair_places_.push_back(to);
      pair_places_.push_back(from);
    }
    pair_starts_.push_back(static_cast<std::int32_t>(pair_places_.size()));
  }
  auto pair = part_pairs_.begin();
  for (std::int32_t part = 0; part <= parts; ++part) {
    while (pair != part_pairs_.end() && pair->part < part) ++pair;
    part_blocks_.push_back(first_pair + static_cast<std::int32_t>(pair - part_pairs_.begin()));
  }

  blocks_ = AlignedFloats(size(first_pair + static_cast<std::int32_t>(part_pairs_.size())) * kBlock);
  inverse_.assign(size(aggregates_) * kBlock, 0.0f);
  restricted_.assign(size(aggregates_) * 3, 0.0f);
  corrections_.assign(size(aggregates_) * 3, 0.0f);
  part_slopes_.assign(size(parts), 0.0);
  part_sums_.assign(size(parts) * 3, 0.0);
  sums_.assign(matrix_->columns().size(), Block::Zero());
  right_ = left_ = Vector::Zero(3 * Eigen::Index{nodes_});
  factor_.emplace(*matrix_);
  for (Eigen::Index node = 0; node < nodes_; ++node) matrix_->add_to_diagonal(node, Block::Identity());
  factor_->compute(*matrix_);  // takes its memory
}

std::int32_t CoarseRows::first_aggregate(std::int32_t part) const { return std::min(part * part_aggregates_, aggregates_); }

void CoarseRows::add_part(std::int32_t part, const float* sums) {
  const auto clear = [this](std::int32_t first, std::int32_t last) {
    std::fill(blocks_.data() + size(first) * kBlock, blocks_.data() + size(last) * kBlock, 0.0f);
  };
  clear(3 * first_aggregate(part), 3 * first_aggregate(part + 1));
  clear(part_blocks_[size(part)], part_blocks_[size(part) + 1]);
  const std::int32_t first = pair_starts_[size(part)];
  FOLLOWTHROUGH_KERNEL(add_blocks)
  (pair_places_.data() + first, (pair_starts_[size(part) + 1] - first) / 2, sums, blocks_.data());
}

void CoarseRows::compute() {
  std::fill(sums_.begin(), sums_.end(), Block::Zero());
  const auto own_of = [this](std::int32_t node) { return size(matrix_->diagonal()[size(node)]); };
  for (std::int32_t aggregate = 0; aggregate < aggregates_; ++aggregate) {
    const float* const from = blocks_.data() + size(aggregate) * 3 * kBlock;
    const Block holding = own_block_at(from) + symmetric_part(block_at(from + kBlock));
    sums_[own_of(aggregate / part_aggregates_ / parts_a_node_)] += holding;
    const Block whole =
        holding - symmetric_part(block_at(from + 2 * kBlock)) + aggregate_masses_[size(aggregate)] * Block::Identity();
    const Eigen::LLT<Block> factored(whole);
    Block inverse = Block::Zero();
    if (factored.info() == Eigen::Success) inverse = weight * symmetric_part(whole.inverse());
    if (!inverse.allFinite()) inverse.setZero();
    Eigen::Map<RowBlock>(inverse_.data() + size(aggregate) * kBlock) = inverse.cast<float>();
  }
  const float* from = blocks_.data() + size(aggregates_) * 3 * kBlock;
  for (const PartPair& pair : part_pairs_) {
    const Block between = block_at(from), mass = pair.mass * Block::Identity();
    sums_[size(pair.block)] += between + mass;
    sums_[size(pair.turned)] += between.transpose() + mass;
    sums_[own_of(pair.part / parts_a_node_)] -= symmetric_part(between);
    sums_[own_of(pair.other / parts_a_node_)] -= symmetric_part(between);
    from += kBlock;
  }
  for (std::int32_t node = 0; node < nodes_; ++node) sums_[own_of(node)] += node_masses_[size(node)] * Block::Identity();
  for (std::size_t k = 0; k < sums_.size(); ++k) matrix_->set(static_cast<Index>(k), sums_[k]);
  definite_ = factor_->compute(*matrix_);
}

void CoarseRows::correct_part(std::int32_t part) {
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  double slope = 0;
  for (std::int32_t aggregate = first_aggregate(part); aggregate < first_aggregate(part + 1); ++aggregate) {
    const Eigen::Map<const Eigen::Vector3f> restricted(restricted_.data() + size(aggregate) * 3);
    Eigen::Map<Eigen::Vector3f> correction(corrections_.data() + size(aggregate) * 3);
    correction.noalias() = Eigen::Map<const RowBlock>(inverse_.data() + size(aggregate) * kBlock) * restricted;
    sum += restricted.cast<double>();
    slope += restricted.cast<double>().dot(correction.cast<double>());
  }
  Eigen::Map<Eigen::Vector3d>(part_sums_.data() + size(part) * 3) = sum;
  part_slopes_[size(part)] = slope;
}

void CoarseRows::solve_nodes() {
  slope_ = 0;
  right_.setZero();
  for (std::int32_t part = 0; part < part_count(); ++part) {
    right_.segment<3>(3 * (part / parts_a_node_)) += Eigen::Map<const Eigen::Vector3d>(part_sums_.data() + size(part) * 3);
    slope_ += part_slopes_[size(part)];
  }
  left_.setZero();
  if (!definite_) return;
  factor_->apply(right_, left_);
  left_ = (weight * left_).cast<float>().cast<double>();
  slope_ += right_.dot(left_);
}

void CoarseRows::add_nodes(std::int32_t part) {
  const Eigen::Vector3f correction = left_.segment<3>(3 * (part / parts_a_node_)).cast<float>();
  for (std::int32_t aggregate = first_aggregate(part); aggregate < first_aggregate(part + 1); ++aggregate) {
    Eigen::Map<Eigen::Vector3f>(corrections_.data() + size(aggregate) * 3) += correction;
  }
}

}  // namespace followthrough
