// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/lane_system.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>

#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr std::int32_t lanes = row_lanes;
// Groups that one thread takes in order, and whose sums stay together.
constexpr std::int32_t block_groups = LaneSystem::part_rows / lanes;
static_assert(block_groups % aggregate_groups == 0);
// What a slot takes on one core; and, with its elements' stiffness, to assemble.
constexpr double slot_nanoseconds = 20, assembly_nanoseconds = 400;
// Elements whose stiffness may stay in the caches as a whole.
constexpr std::size_t one_part_tets = 4096;
// Aggregates that are worth a coarse system.
constexpr std::int32_t fewest_aggregates = 8;
constexpr int coarse_block = 9;

std::size_t rounded_up(std::size_t count) { return (count + single_lanes - 1) / single_lanes * single_lanes; }

struct Kernels {
  decltype(&baseline::assemble_lane_rows) assemble;
  decltype(&baseline::start_lane_rows) start;
  decltype(&baseline::multiply_lane_rows) multiply;
  decltype(&baseline::advance_lane_rows) advance;
  decltype(&baseline::turn_lane_rows) turn;
};

Kernels kernels() {
  return {FOLLOWTHROUGH_KERNEL(assemble_lane_rows), FOLLOWTHROUGH_KERNEL(start_lane_rows), FOLLOWTHROUGH_KERNEL(multiply_lane_rows),
          FOLLOWTHROUGH_KERNEL(advance_lane_rows), FOLLOWTHROUGH_KERNEL(turn_lane_rows)};
}

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
      for (std::int32_t lane = 0; lane < lanes; ++lane) columns_[slot * lanes + lane] = 4 * (group * lanes + lane);
    }
  }
  for (auto row = static_cast<std::int32_t>(row_count_); row < padded_; ++row) {
    masses_[slot_starts_[row / lanes] * lanes + row % lanes] = 1.0f;
  }
  for (std::size_t k = 0; k < columns.size(); ++k) {
    columns_[places[k]] = 4 * columns[k];
    masses_[places[k]] = static_cast<float>(unit_ * constant.blocks()[k](0, 0));
  }

  find_parts(constant, tets, places);
  find_coarse(constant, tets, places);
  blocks_.resize(slots * lanes * 9);
  inverse_.resize(static_cast<std::size_t>(padded_) * 6);
  vectors_.resize(static_cast<std::size_t>(padded_) * 16);
}

// Which elements each part needs, and which of their blocks a place adds up.
void LaneSystem::find_parts(const BlockMatrix& constant, std::size_t tets, const std::vector<std::int32_t>& places) {
  part_groups_ = tets <= one_part_tets ? groups_ : block_groups;
  const std::vector<Index>& starts = constant.starts();
  std::vector<std::int32_t> part_of(places.size());  // by block
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    std::fill(part_of.begin() + starts[row], part_of.begin() + starts[row + 1],
              static_cast<std::int32_t>(row / lanes) / part_groups_);
  }
  std::vector<std::vector<Index>> needed(static_cast<std::size_t>((groups_ + part_groups_ - 1) / part_groups_));
  for (std::size_t tet = 0; tet < tets; ++tet) {
    for (int corner = 0; corner < 4; ++corner) {
      const Index k = constant.slot(tet, corner, corner);
      if (k < 0) continue;
      std::vector<Index>& part = needed[static_cast<std::size_t>(part_of[k])];
      if (part.empty() || part.back() != static_cast<Index>(tet)) part.push_back(static_cast<Index>(tet));
    }
  }
  part_starts_.push_back(0);
  for (std::vector<Index>& part : needed) {
    part.resize(rounded_up(part.size()), part.back());
    part_tets_.insert(part_tets_.end(), part.begin(), part.end());
    part_starts_.push_back(part_tets_.size());
    largest_part_ = std::max(largest_part_, part.size());
  }

  // Counted first, then filled in.
  share_starts_.assign(2 * columns_.size() + 1, 0);
  const auto for_shares = [&](const auto& visit) {
    for (std::size_t part = 0; part < needed.size(); ++part) {
      const auto take = [&](Index k, bool turned, std::int32_t block) {
        if (k >= 0 && part_of[k] == static_cast<std::int32_t>(part)) visit(2 * places[k] + turned, block);
      };
      Index before = -1;
      for (std::size_t local = 0; local < needed[part].size(); ++local) {
        const Index tet = needed[part][local];
        if (tet == before) break;  // what is to spare
        before = tet;
        for (int pair = 0; pair < 10; ++pair) {
          const int a = stiffness_corners[pair][0], b = stiffness_corners[pair][1];
          const auto block = static_cast<std::int32_t>(local * stiffness_floats) + 9 * pair;
          take(constant.slot(tet, a, b), false, block);
          if (a != b) take(constant.slot(tet, b, a), true, block);
        }
      }
    }
  };
  for_shares([&](std::int32_t list, std::int32_t) { ++share_starts_[list + 1]; });
  for (std::size_t list = 1; list < share_starts_.size(); ++list) share_starts_[list] += share_starts_[list - 1];
  share_blocks_.resize(static_cast<std::size_t>(share_starts_.back()));
  std::vector<std::int32_t> next(share_starts_.begin(), share_starts_.end() - 1);
  for_shares([&](std::int32_t list, std::int32_t block) { share_blocks_[next[list]++] = block; });
}

// Where blocks count in the coarse system: those between aggregates, which with their sign turned are the diagonal's as well; and
// all of the rows beside something constrained, as those have what holds the aggregate.
void LaneSystem::find_coarse(const BlockMatrix& constant, std::size_t tets, const std::vector<std::int32_t>& places) {
  const auto aggregate = [](Eigen::Index row) { return static_cast<Index>(row / lanes / aggregate_groups); };
  const Index count = aggregate(row_count_ - 1) + 1;
  if (count < fewest_aggregates) return;
  const std::vector<Index>&starts = constant.starts(), &columns = constant.columns();
  std::vector<Index> owners(columns.size());
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    std::fill(owners.begin() + starts[row], owners.begin() + starts[row + 1], static_cast<Index>(row));
  }
  std::vector<char> held(static_cast<std::size_t>(row_count_), 0);
  for (std::size_t tet = 0; tet < tets; ++tet) {
    bool free = true;
    for (int a = 0; a < 4; ++a) free = free && constant.slot(tet, a, a) >= 0;
    for (int a = 0; a < 4 && !free; ++a) {
      const Index k = constant.slot(tet, a, a);
      if (k >= 0) held[owners[k]] = 1;
    }
  }
  std::vector<std::array<Index, 4>> pairs;
  for (std::size_t k = 0; k < columns.size(); ++k) {
    const Index own = aggregate(owners[k]), other = aggregate(columns[k]);
    if (own < other) pairs.push_back({own, other, other, other});
  }
  std::sort(pairs.begin(), pairs.end());
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
  std::vector<Index> all(static_cast<std::size_t>(count));
  for (Index k = 0; k < count; ++k) all[k] = k;
  BlockMatrix matrix(pairs, all);
  SparseCholesky factor(matrix);
  const auto blocks = static_cast<std::int32_t>(matrix.columns().size());
  coarse_places_.assign(columns_.size(), -1);
  std::vector<double> masses(static_cast<std::size_t>(blocks), 0.0);
  for (std::size_t k = 0; k < columns.size(); ++k) {
    const Index own = aggregate(owners[k]), other = aggregate(columns[k]);
    const auto first = matrix.columns().begin() + matrix.starts()[own], last = matrix.columns().begin() + matrix.starts()[own + 1];
    const auto block = static_cast<std::int32_t>(std::lower_bound(first, last, other) - matrix.columns().begin());
    masses[block] += unit_ * constant.blocks()[k](0, 0);
    if (own != other || held[owners[k]]) coarse_places_[places[k]] = coarse_block * (held[owners[k]] ? blocks + block : block);
  }
  coarse_.emplace(Coarse{std::move(matrix), std::move(factor), std::move(masses),
                         std::vector<float>(2 * coarse_block * std::size_t(blocks)), std::vector<float>(3 * std::size_t(count)),
                         std::vector<float>(3 * std::size_t(count)), Vector(3 * count), Vector(3 * count)});
}

LaneRows LaneSystem::rows() const {
  // The kernels that only read take the same struct as the one that assembles.
  return {padded_,
          slot_starts_.data(),
          columns_.data(),
          masses_.data(),
          share_starts_.data(),
          share_blocks_.data(),
          coarse_places_.data(),
          const_cast<float*>(blocks_.data()),
          const_cast<float*>(inverse_.data())};
}

LaneVectors LaneSystem::vectors() {
  const std::size_t size = 3 * static_cast<std::size_t>(padded_);
  float *const direction = vectors_.data(), *const first = direction + 4 * static_cast<std::size_t>(padded_);
  float* const restricted = has_coarse() ? coarse_->restricted.data() : nullptr;
  return {first,
          first + size,
          direction,
          first + 2 * size,
          first + 3 * size,
          restricted,
          has_coarse() ? coarse_->corrections.data() : nullptr};
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

bool LaneSystem::assemble(const Fill& fill, bool renew_coarse) {
  const auto kernel = kernels().assemble;
  const LaneRows all = rows();
  const auto parts = static_cast<std::int32_t>(part_starts_.size()) - 1;
  const auto slots = static_cast<std::ptrdiff_t>(columns_.size()) / lanes;
  std::vector<char> definite(static_cast<std::size_t>(parts), 1);
  renew_coarse = renew_coarse && coarse_;
  if (renew_coarse) std::fill(coarse_->sums.begin(), coarse_->sums.end(), 0.0f);
  float* const coarse = renew_coarse ? coarse_->sums.data() : nullptr;
  const int threads = worthwhile_threads(slots, assembly_nanoseconds);
  workspaces_.resize(std::max(workspaces_.size(), static_cast<std::size_t>(threads)));
#pragma omp parallel num_threads(threads)
  {
    std::vector<float>& stiffness = workspaces_[static_cast<std::size_t>(omp_get_thread_num())];
    stiffness.resize(largest_part_ * stiffness_floats + single_lanes);
#pragma omp for schedule(static)
    for (std::int32_t part = 0; part < parts; ++part) {
      fill(static_cast<std::size_t>(part), stiffness.data());
      const std::int32_t first = part * part_groups_, last = std::min(first + part_groups_, groups_);
      definite[part] = static_cast<char>(kernel(all, stiffness.data(), coarse, first, last));
    }
  }
  const bool positive = std::all_of(definite.begin(), definite.end(), [](char one) { return one != 0; });
  if (renew_coarse && positive) factor_coarse();
  return positive;
}

void LaneSystem::factor_coarse() {
  BlockMatrix& matrix = coarse_->matrix;
  const std::size_t blocks = coarse_->masses.size();
  const auto sum = [&](std::size_t k) {
    return Eigen::Map<const Eigen::Matrix<float, 3, 3, Eigen::RowMajor>>(&coarse_->sums[coarse_block * k]).cast<double>().eval();
  };
  for (Eigen::Index row = 0; row < matrix.row_count(); ++row) {
    const auto own = static_cast<std::size_t>(matrix.diagonal()[row]);
    BlockMatrix::Block held = sum(blocks + own);
    for (auto k = static_cast<std::size_t>(matrix.starts()[row]); k < static_cast<std::size_t>(matrix.starts()[row + 1]); ++k) {
      if (k == own) continue;
      const BlockMatrix::Block between = sum(k);
      held -= between;
      matrix.set(static_cast<Index>(k), between + sum(blocks + k) + coarse_->masses[k] * BlockMatrix::Block::Identity());
    }
    matrix.set(static_cast<Index>(own), 0.5 * (held + held.transpose()) + coarse_->masses[own] * BlockMatrix::Block::Identity());
  }
  coarse_->definite = coarse_->factor.compute(matrix);
}

// The coarse system's share of the preconditioned residual; adds what it has of the product with the residual.
double LaneSystem::correct(double slope) {
  if (!has_coarse()) return slope;
  Coarse& coarse = *coarse_;
  for (Eigen::Index k = 0; k < coarse.right.size(); ++k) coarse.right[k] = static_cast<double>(coarse.restricted[k]);
  coarse.factor.apply(coarse.right, coarse.left);
  for (Eigen::Index k = 0; k < coarse.right.size(); ++k) {
    coarse.corrections[k] = static_cast<float>(coarse.left[k]);
    slope += coarse.right[k] * static_cast<double>(coarse.corrections[k]);
  }
  return slope;
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

// The first direction, from b over its size.
void LaneSystem::start(const Vector& b, double size, double (&sums)[2]) {
  const Kernels kernel = kernels();
  const LaneRows all = rows();
  const LaneVectors v = vectors();
  std::fill_n(v.residual, 3 * static_cast<std::size_t>(padded_), 0.0f);
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    for (int axis = 0; axis < 3; ++axis) v.residual[axis * padded_ + row] = static_cast<float>(b[3 * row + axis] / size);
  }
  summed([&](std::int32_t first, std::int32_t last, RowSums* part) { kernel.start(all, v, first, last, part); }, sums);
  sums[0] = correct(sums[0]);
  for_blocks([&](std::size_t, std::int32_t first, std::int32_t last) { kernel.turn(all, v, 0, first, last); });
}

Vector LaneSystem::preconditioned(const Vector& b) {
  Vector z = Vector::Zero(b.size());
  const double size = b.norm();
  if (!(size > 0)) return z;
  double sums[2];
  start(b, size, sums);
  const float* const direction = vectors().direction;
  for (Eigen::Index row = 0; row < row_count_; ++row) {
    for (int axis = 0; axis < 3; ++axis) z[3 * row + axis] = size * unit_ * static_cast<double>(direction[4 * row + axis]);
  }
  return z;
}

LinearReport LaneSystem::solve(const Vector& b, double tolerance, int most_iterations, Vector& x) {
  LinearReport report;
  x.setZero(b.size());
  const double size = b.norm();
  report.converged = !(size > 0);
  if (report.converged) return report;
  double sums[2], product[2];
  start(b, size, sums);
  const Kernels kernel = kernels();
  const LaneRows all = rows();
  const LaneVectors v = vectors();
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
    sums[0] = correct(sums[0]);
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
