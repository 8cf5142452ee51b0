// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/newton_patches.hpp"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>

#include "emulator/newton_problem.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

struct Kernels {
  decltype(&baseline::edge_inputs) edge_inputs;
  decltype(&baseline::centre_inputs) centre_inputs;
};

Kernels kernels() {
  switch (instruction_set()) {
#ifdef FOLLOWTHROUGH_HAS_avx512
    case InstructionSet::avx512:
      return {avx512::edge_inputs, avx512::centre_inputs};
#endif
#ifdef FOLLOWTHROUGH_HAS_avx2
    case InstructionSet::avx2:
      return {avx2::edge_inputs, avx2::centre_inputs};
#endif
    default:
      return {baseline::edge_inputs, baseline::centre_inputs};
  }
}

void require_evaluated(const NewtonProblem& problem) {
  if (!problem.evaluated) throw InvalidInput("estimate", "found none that was evaluated, expected begin and evaluate before this");
}

}  // namespace

NewtonPatches::NewtonPatches(const NewtonBody& body) : problem_(std::make_unique<NewtonProblem>(body)) {}
NewtonPatches::~NewtonPatches() = default;
NewtonPatches::NewtonPatches(NewtonPatches&&) noexcept = default;
NewtonPatches& NewtonPatches::operator=(NewtonPatches&&) noexcept = default;

Eigen::Index NewtonPatches::vertex_count() const { return problem_->count; }
double NewtonPatches::edge_length() const { return problem_->edge_length; }
const Vector& NewtonPatches::stiffness() const { return problem_->stiffness; }
const std::vector<Index>& NewtonPatches::free_vertices() const { return problem_->free_vertices; }
const std::vector<Index>& NewtonPatches::edge_starts() const { return problem_->edge_starts; }
const std::vector<Index>& NewtonPatches::neighbours() const { return problem_->edge_vertices; }

void NewtonPatches::begin(const NewtonHistory& history, double beta) {
  const auto require = [this](const char* name, const ConstPositions& positions) {
    require_rows(name, positions.rows(), problem_->count);
    require_finite(name, positions);
  };
  require("now", history.now);
  require("before", history.before);
  require("before_that", history.before_that);
  require("reference_before", history.reference_before);
  require("reference_now", history.reference_now);
  require("reference_next", history.reference_next);
  if (!(beta >= 0.0 && beta <= 1.0)) throw InvalidInput("beta", "found " + std::to_string(beta) + ", expected 0 to 1");
  problem_->begin(history, beta);
}

double NewtonPatches::evaluate(int iterations) {
  if (!problem_->began) throw InvalidInput("estimate", "found none, expected begin before evaluate");
  if (iterations < 0) throw InvalidInput("iterations", "found " + std::to_string(iterations) + ", expected 0 or more");
  const double size = problem_->assemble();
  if (!problem_->frames_found) problem_->find_frames();
  problem_->solve(iterations);
  return size;
}

PatchFeatures NewtonPatches::features(std::string_view channels) {
  require_channels("channels", channels);
  NewtonProblem& p = *problem_;
  require_evaluated(p);
  const std::vector<std::int32_t> columns = channel_columns(channels);
  p.describe(columns);
  const Kernels kernel = kernels();
  const auto inputs = static_cast<Eigen::Index>(3 * channels.size());
  PatchFeatures result;
  result.edges.resize(static_cast<Eigen::Index>(p.edge_rows.size()), inputs + 8);
  result.centres.resize(p.free_count, inputs + 17);
  result.sizes = Eigen::Map<const Eigen::VectorXf>(p.sizes.data(), p.free_count);
  result.rotations = Eigen::Map<const PatchFeatures::Rows>(p.rotations.data(), p.free_count, 9);
  std::vector<float> rows;
  for (std::int32_t group = 0; group < p.groups; ++group) {
    const std::int32_t first = group * kNewtonGroup, last = std::min(first + kNewtonGroup, p.free_count);
    const Index first_edge = p.edge_starts[static_cast<std::size_t>(first)];
    const Index edges = p.edge_starts[static_cast<std::size_t>(last)] - first_edge;
    rows.resize(static_cast<std::size_t>(std::max((edges + kNewtonGroup) * kNewtonEdgeStride, kNewtonGroup * kNewtonCentreStride)));
    kernel.edge_inputs(p.patch_frame, first, last, rows.data(), kNewtonEdgeStride);
    result.edges.middleRows(first_edge, edges) =
        Eigen::Map<const PatchFeatures::Rows>(rows.data(), edges, kNewtonEdgeStride).leftCols(inputs + 8);
    kernel.centre_inputs(p.patch_frame, group, rows.data(), kNewtonCentreStride);
    result.centres.middleRows(first, last - first) =
        Eigen::Map<const PatchFeatures::Rows>(rows.data(), last - first, kNewtonCentreStride).leftCols(inputs + 17);
  }
  return result;
}

NewtonPatches::Steps NewtonPatches::direction() const {
  const NewtonProblem& p = *problem_;
  require_evaluated(p);
  Steps steps(p.free_count, 3);
  for (Eigen::Index k = 0; k < 3; ++k)
    steps.col(k) = Eigen::Map<const Eigen::VectorXf>(p.solution.data() + k * p.padded, p.free_count);
  return steps;
}

void NewtonPatches::move(const Steps& step) {
  if (!problem_->began) throw InvalidInput("estimate", "found none, expected begin before move");
  require_rows("step", step.rows(), problem_->free_count);
  if (!step.allFinite()) throw InvalidInput("step", "found NaN or infinity, expected finite numbers");
  problem_->move(step.data());
}

Positions NewtonPatches::estimate() const {
  if (!problem_->began) throw InvalidInput("estimate", "found none, expected begin before this");
  Positions positions(problem_->count, 3);
  problem_->write_estimate(positions);
  return positions;
}

}  // namespace followthrough
