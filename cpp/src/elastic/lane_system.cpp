// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/lane_system.hpp"

#include <algorithm>
#include <cmath>

#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr std::int32_t lanes = row_lanes;
// Groups that one thread takes in order, and whose sums stay together.
constexpr std::int32_t block_groups = 16;
// What a slot takes on one core.
constexpr double slot_nanoseconds = 20;

struct Kernels {
  decltype(&baseline::assemble_lane_rows) assemble;
  decltype(&baseline::start_lane_rows) start;
  decltype(&baseline::multiply_lane_rows) multiply;
  decltype(&baseline::advance_lane_rows) advance;
  decltype(&baseline::turn_lane_rows) turn;
};

#define FOLLOWTHROUGH_LANE_KERNELS(isa) \
  {isa::assemble_lane_rows, isa::start_lane_rows, isa::multiply_lane_rows, isa::advance_lane_rows, isa::turn_lane_rows}

Kernels kernels() {
  switch (instruction_set()) {
#ifdef FOLLOWTHROUGH_HAS_avx512
    case InstructionSet::avx512:
      return FOLLOWTHROUGH_LANE_KERNELS(avx512);
#endif
#ifdef FOLLOWTHROUGH_HAS_avx2
    case InstructionSet::avx2:
      return FOLLOWTHROUGH_LANE_KERNELS(avx2);
#endif
    default:
      return FOLLOWTHROUGH_LANE_KERNELS(baseline);
  }
}
#undef FOLLOWTHROUGH_LANE_KERNELS

}  // namespace

LaneSystem::LaneSystem(const BlockMatrix& constant, std::size_t tets)
    : row_count_(constant.row_count()),
      padded_(static_cast<std::int32_t>((row_count_ + lanes - 1) / lanes * lanes)),
      groups_(padded_ / lanes) {
  const std::vector<Index>&starts = constant.starts(), &columns = constant.columns(), &diagonal = constant.diagonal();
  double sum = 0;
  for (const Index k : diagonal) sum += constant.blocks()[k](0, 0);
  unit_ = static_cast<double>(row_count_) / sum;

  // Place of every block: slot * lanes + lane. A row's diagonal comes first.
  std::vector<std::int32_t> places(columns.size());
  slot_starts_.push_back(0);
  for (std::int32_t group = 0; group < groups_; ++group) {
    const std::int32_t first = slot_starts_.back();
    std::int32_t most = 1;
    for (std::int32_t lane = 0; lane < lanes; ++lane) {
      const std::int32_t row = group * lanes + lane;
      if (row >= row_count_) continue;
      std::int32_t next = 1;
      for (Index k = starts[row]; k < starts[row + 1]; ++k) {
        places[k] = (first + (k == diagonal[row] ? 0 : next++)) * lanes + lane;
      }
      most = std::max(most, next);
    }
    slot_starts_.push_back(first + most);
  }
  const auto slots = static_cast<std::size_t>(slot_starts_.back());
  columns_.resize(slots * lanes);
  masses_.assign(slots * lanes, 0.0f);
  for (std::int32_t group = 0; group < groups_; ++group) {
    for (std::int32_t slot = slot_starts_[group]; slot < slot_starts_[group + 1]; ++slot) {
      for (std::int32_t lane = 0; lane < lanes; ++lane) columns_[slot * lanes + lane] = group * lanes + lane;
    }
  }
  for (auto row = static_cast<std::int32_t>(row_count_); row < padded_; ++row) {
    masses_[slot_starts_[row / lanes] * lanes + row % lanes] = 1.0f;
  }
  for (std::size_t k = 0; k < columns.size(); ++k) {
    columns_[places[k]] = columns[k];
    masses_[places[k]] = static_cast<float>(unit_ * constant.blocks()[k](0, 0));
  }

  // Which elements' blocks a place adds up: counted first, then filled in.
  share_starts_.assign(2 * slots * lanes + 1, 0);
  const auto for_shares = [&](const auto& visit) {
    for (std::size_t tet = 0; tet < tets; ++tet) {
      for (int pair = 0; pair < 10; ++pair) {
        const int a = stiffness_corners[pair][0], b = stiffness_corners[pair][1];
        const Index k = constant.slot(tet, a, b);
        if (k < 0) continue;
        const auto block = static_cast<std::int32_t>(tet * stiffness_floats) + 9 * pair;
        visit(2 * places[k], block);
        if (a != b) visit(2 * places[constant.slot(tet, b, a)] + 1, block);
      }
    }
  };
  for_shares([&](std::int32_t list, std::int32_t) { ++share_starts_[list + 1]; });
  for (std::size_t list = 1; list < share_starts_.size(); ++list) share_starts_[list] += share_starts_[list - 1];
  share_blocks_.resize(static_cast<std::size_t>(share_starts_.back()));
  std::vector<std::int32_t> next(share_starts_.begin(), share_starts_.end() - 1);
  for_shares([&](std::int32_t list, std::int32_t block) { share_blocks_[next[list]++] = block; });

  blocks_.resize(slots * lanes * 9);
  inverse_.resize(static_cast<std::size_t>(padded_) * 6);
  vectors_.resize(static_cast<std::size_t>(padded_) * 15);
}

LaneRows LaneSystem::rows() const {
  // The kernels that only read take the same struct as the one that assembles.
  return {padded_,
          slot_starts_.data(),
          columns_.data(),
          masses_.data(),
          share_starts_.data(),
          share_blocks_.data(),
          const_cast<float*>(blocks_.data()),
          const_cast<float*>(inverse_.data())};
}

LaneVectors LaneSystem::vectors() {
  const std::size_t size = 3 * static_cast<std::size_t>(padded_);
  float* const first = vectors_.data();
  return {first, first + size, first + 2 * size, first + 3 * size, first + 4 * size};
}

// work(block, first group, one after its last)
template <typename Work>
void LaneSystem::for_blocks(const Work& work) const {
  const std::int32_t blocks = (groups_ + block_groups - 1) / block_groups;
  const auto slots = static_cast<std::ptrdiff_t>(columns_.size()) / lanes;
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(slots, slot_nanoseconds))
  for (std::int32_t block = 0; block < blocks; ++block) {
    work(static_cast<std::size_t>(block), block * block_groups, std::min((block + 1) * block_groups, groups_));
  }
}

// work(first group, one after its last, sums); all sums in one order.
template <typename Work>
void LaneSystem::summed(const Work& work, double (&sums)[2]) const {
  const auto blocks = static_cast<std::size_t>((groups_ + block_groups - 1) / block_groups);
  std::vector<RowSums> parts(blocks);
  for_blocks([&](std::size_t block, std::int32_t first, std::int32_t last) { work(first, last, &parts[block]); });
  sums[0] = sums[1] = 0;
  for (const RowSums& part : parts) {
    for (int k = 0; k < 2; ++k) {
      for (const float lane : part.sums[k]) sums[k] += static_cast<double>(lane);
    }
  }
}

bool LaneSystem::assemble(const std::vector<float>& stiffness) {
  const auto kernel = kernels().assemble;
  const LaneRows all = rows();
  std::vector<char> definite(static_cast<std::size_t>(groups_ / block_groups + 1), 1);
  for_blocks([&](std::size_t block, std::int32_t first, std::int32_t last) {
    definite[block] = static_cast<char>(kernel(all, stiffness.data(), first, last));
  });
  return std::all_of(definite.begin(), definite.end(), [](char one) { return one != 0; });
}

double LaneSystem::stiffness_ratio() const {
  double ratio = 0;
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    const auto slot = static_cast<std::size_t>(slot_starts_[row / lanes]), lane = static_cast<std::size_t>(row % lanes);
    const float* const block = &blocks_[slot * 9 * lanes + lane];
    ratio += static_cast<double>((block[0] + block[4 * lanes] + block[8 * lanes]) / (3 * masses_[slot * lanes + lane]));
  }
  return ratio / static_cast<double>(row_count_);
}

LinearReport LaneSystem::solve(const Vector& b, double tolerance, int most_iterations, Vector& x) {
  LinearReport report;
  x.setZero(b.size());
  const double size = b.norm();
  report.converged = !(size > 0);
  if (report.converged) return report;
  const Kernels kernel = kernels();
  const LaneRows all = rows();
  const LaneVectors v = vectors();
  std::fill_n(v.residual, 3 * static_cast<std::size_t>(padded_), 0.0f);
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    for (int axis = 0; axis < 3; ++axis) v.residual[axis * padded_ + row] = static_cast<float>(b[3 * row + axis] / size);
  }
  double sums[2], product[2];
  summed([&](std::int32_t first, std::int32_t last, RowSums* part) { kernel.start(all, v, first, last, part); }, sums);
  const double goal = tolerance * tolerance;
  while (report.iterations < most_iterations && !(sums[1] <= goal)) {
    summed([&](std::int32_t first, std::int32_t last, RowSums* part) { kernel.multiply(all, v, first, last, part); }, product);
    const double slope = sums[0];
    if (!(product[0] > 0 && slope > 0)) {
      report.negative_curvature = true;
      break;
    }
    const auto length = static_cast<float>(slope / product[0]);
    summed([&](std::int32_t first, std::int32_t last, RowSums* part) { kernel.advance(all, v, length, first, last, part); }, sums);
    ++report.iterations;
    const auto share = static_cast<float>(sums[0] / slope);
    for_blocks([&](std::size_t, std::int32_t first, std::int32_t last) { kernel.turn(all, v, share, first, last); });
  }
  report.converged = sums[1] <= goal;
  const double scale = size * unit_;
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    for (int axis = 0; axis < 3; ++axis) x[3 * row + axis] = scale * static_cast<double>(v.solution[axis * padded_ + row]);
  }
  return report;
}

}  // namespace followthrough
