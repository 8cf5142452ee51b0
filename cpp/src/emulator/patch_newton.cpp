// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/patch_newton.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "emulator/newton_problem.hpp"
#include "emulator/packed_layers.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

// Root mean square of the first preconditioned residual, in edges, below which a pass has nothing to do: rounding.
constexpr double nothing_left = 1e-7;
// How much larger it may be after a network's step.
constexpr double tolerated_growth = 4.0;
// What a core does at least, multiply-adds a nanosecond.
constexpr double slowest_rate = 30.0;

decltype(&baseline::predict_steps) predict_steps_kernel() {
  switch (instruction_set()) {
#ifdef FOLLOWTHROUGH_HAS_avx512
    case InstructionSet::avx512:
      return avx512::predict_steps;
#endif
#ifdef FOLLOWTHROUGH_HAS_avx2
    case InstructionSet::avx2:
      return avx2::predict_steps;
#endif
    default:
      return baseline::predict_steps;
  }
}

void require_layer(const std::string& place, const DenseLayer& layer, Eigen::Index inputs, Eigen::Index outputs, bool with_bias) {
  if (layer.weight.cols() != inputs || layer.weight.rows() < 1 || (outputs && layer.weight.rows() != outputs)) {
    throw InvalidInput(place + ".weight", "found " + std::to_string(layer.weight.rows()) + " x " +
                                              std::to_string(layer.weight.cols()) + ", expected " +
                                              (outputs ? std::to_string(outputs) + " rows and " : "") + std::to_string(inputs) +
                                              " columns, one an input");
  }
  if (layer.bias.size() != (with_bias ? layer.weight.rows() : 0)) {
    throw InvalidInput(place + ".bias", "found " + std::to_string(layer.bias.size()) + " numbers, expected " +
                                            std::to_string(with_bias ? layer.weight.rows() : 0));
  }
  if (!layer.weight.allFinite()) throw InvalidInput(place + ".weight", "found NaN or infinity, expected finite numbers");
  if (!layer.bias.allFinite()) throw InvalidInput(place + ".bias", "found NaN or infinity, expected finite numbers");
}

void require_pass(const std::string& place, const NewtonPass& pass) {
  if (pass.iterations < 0) {
    throw InvalidInput(place + ".iterations", "found " + std::to_string(pass.iterations) + ", expected 0 or more");
  }
  if (!pass.has_network()) return;
  require_channels(place + ".channels", pass.channels);
  const auto vectors = static_cast<Eigen::Index>(3 * pass.channels.size());
  if (pass.edge.empty()) throw InvalidInput(place + ".edge", "found no layers, expected at least 1");
  if (pass.instance.empty()) throw InvalidInput(place + ".instance", "found no layers, expected at least 1");
  Eigen::Index width = vectors + 8;
  for (std::size_t k = 0; k < pass.edge.size(); ++k) {
    require_layer(place + ".edge." + std::to_string(k), pass.edge[k], width, 0, k > 0);
    width = pass.edge[k].weight.rows();
  }
  require_layer(place + ".centre", pass.centre, vectors + 17, pass.edge.front().weight.rows(), true);
  width += vectors + 17;
  for (std::size_t k = 0; k < pass.instance.size(); ++k) {
    require_layer(place + ".instance." + std::to_string(k), pass.instance[k], width, 0, true);
    width = pass.instance[k].weight.rows();
  }
  require_layer(place + ".out", pass.out, width, 3, false);
  if (!std::isfinite(pass.skip)) {
    throw InvalidInput(place + ".skip", "found " + std::to_string(pass.skip) + ", expected a finite number");
  }
}

// A pass's network, packed.
struct PackedPass {
  PackedPass(const NewtonPass& pass);

  int iterations;
  std::vector<std::int32_t> columns;  // empty: no network
  PackedLayers layers;
  std::vector<DenseKernel> edges, instances;
  NewtonNetwork network{};
  double edge_cost = 0, vertex_cost = 0;
};

PackedPass::PackedPass(const NewtonPass& pass) : iterations(pass.iterations), columns(channel_columns(pass.channels)) {
  if (columns.empty()) return;
  const auto pack = [this](const Eigen::MatrixXd& weight, const Eigen::VectorXf& bias) {
    const DenseKernel layer = layers.pack(weight, bias.cast<double>());
    network.widest = std::max(network.widest, layer.outputs);
    return layer;
  };
  network.edge_first = pack(pass.edge.front().weight.cast<double>(), {});
  network.centre = pack(pass.centre.weight.cast<double>(), pass.centre.bias);
  for (std::size_t k = 1; k < pass.edge.size(); ++k) edges.push_back(pack(pass.edge[k].weight.cast<double>(), pass.edge[k].bias));
  for (const DenseLayer& layer : pass.edge) edge_cost += static_cast<double>(layer.weight.size());
  vertex_cost = static_cast<double>(pass.centre.weight.size() + pass.out.weight.size());
  for (std::size_t k = 0; k < pass.instance.size(); ++k) {
    Eigen::MatrixXd weight = pass.instance[k].weight.cast<double>();
    vertex_cost += static_cast<double>(weight.size());
    if (k == 0) {
      // The sum's columns are padded, and scaled.
      const Eigen::Index sum = pass.edge.back().weight.rows(), inputs = pass.centre.weight.cols();
      Eigen::MatrixXd joined = Eigen::MatrixXd::Zero(weight.rows(), padded_width(sum) + inputs);
      joined.leftCols(sum) = weight.leftCols(sum) / 8.0;
      joined.rightCols(inputs) = weight.rightCols(inputs);
      weight = joined;
      network.joined_width = padded_width(sum) + kNewtonCentreStride;
    }
    instances.push_back(pack(weight, pass.instance[k].bias));
  }
  network.out = pack(pass.out.weight.cast<double>(), Eigen::VectorXf::Zero(3));
  network.edges = edges.data();
  network.edge_count = static_cast<std::int32_t>(edges.size());
  network.instances = instances.data();
  network.instance_count = static_cast<std::int32_t>(instances.size());
  network.skip = pass.skip;
}

}  // namespace

void require_schedule(const NewtonSchedule& schedule) {
  if (!(schedule.beta >= 0.0 && schedule.beta <= 1.0)) {
    throw InvalidInput("beta", "found " + std::to_string(schedule.beta) + ", expected 0 to 1");
  }
  if (schedule.extra_passes < 0) {
    throw InvalidInput("extra_passes", "found " + std::to_string(schedule.extra_passes) + ", expected 0 or more");
  }
  if (schedule.extra_iterations < 0) {
    throw InvalidInput("extra_iterations", "found " + std::to_string(schedule.extra_iterations) + ", expected 0 or more");
  }
  if (schedule.passes.empty() && schedule.extra_passes == 0) throw InvalidInput("passes", "found none, expected at least one");
  for (std::size_t k = 0; k < schedule.passes.size(); ++k) require_pass("passes." + std::to_string(k), schedule.passes[k]);
}

struct PatchNewton::Parts {
  Parts(const NewtonBody& body, const NewtonSchedule& schedule);

  void predict(const PackedPass& pass);
  void solve_frame(ConstPositions reference);
  std::size_t scratch_size() const;

  NewtonProblem problem;
  double beta;
  std::vector<PackedPass> passes;
  std::vector<AlignedFloats> scratch;  // one a thread
  double cost = 0;
  Positions now, before, before_that, next;  // u(t), u(t-1), u(t-2); u(t+1)
  Positions reference_now, reference_before;
  std::int64_t frames = -1;  // since the reset; -1: never reset
};

PatchNewton::Parts::Parts(const NewtonBody& body, const NewtonSchedule& schedule)
    : problem((require_schedule(schedule), body)), beta(schedule.beta) {
  const auto edges = static_cast<double>(problem.edge_rows.size()), frees = static_cast<double>(problem.free_count);
  passes.reserve(schedule.passes.size() + static_cast<std::size_t>(schedule.extra_passes));
  for (const NewtonPass& pass : schedule.passes) passes.emplace_back(pass);
  NewtonPass extra;
  extra.iterations = schedule.extra_iterations;
  for (int k = 0; k < schedule.extra_passes; ++k) passes.emplace_back(extra);
  for (const PackedPass& pass : passes) {
    cost += pass.edge_cost * edges + pass.vertex_cost * frees + 9.0 * pass.iterations * (edges + frees);
  }
  problem.wants_frames = std::any_of(passes.begin(), passes.end(), [](const PackedPass& pass) { return !pass.columns.empty(); });
  next = Positions::Zero(problem.count, 3);
}

std::size_t PatchNewton::Parts::scratch_size() const {
  Index most_edges = 0;
  for (std::int32_t first = 0; first < problem.free_count; first += kNewtonGroup) {
    const std::int32_t last = std::min(first + kNewtonGroup, problem.free_count);
    most_edges = std::max(
        most_edges, problem.edge_starts[static_cast<std::size_t>(last)] - problem.edge_starts[static_cast<std::size_t>(first)]);
  }
  std::size_t most = 0;
  for (const PackedPass& pass : passes) {
    if (pass.columns.empty()) continue;
    const std::int64_t rows = std::max<std::int64_t>(std::int64_t{most_edges + kNewtonGroup} * kNewtonEdgeStride,
                                                     std::int64_t{kNewtonGroup} * pass.network.widest);
    const std::int64_t size = (2 * kBlockRows + kNewtonGroup) * std::int64_t{pass.network.widest} +
                              kNewtonGroup * std::int64_t{pass.network.joined_width} + rows;
    most = std::max(most, static_cast<std::size_t>(size));
  }
  return most;
}

void PatchNewton::Parts::predict(const PackedPass& pass) {
  problem.describe(pass.columns);
  const auto kernel = predict_steps_kernel();
  const double group_cost =
      (pass.edge_cost * static_cast<double>(problem.edge_rows.size()) + pass.vertex_cost * problem.free_count) /
      std::max(1, problem.groups) / slowest_rate;
  const int threads = std::min(worthwhile_threads(problem.groups, group_cost), static_cast<int>(scratch.size()));
#pragma omp parallel for schedule(dynamic, 2) num_threads(threads)
  for (std::int32_t group = 0; group < problem.groups; ++group) {
    kernel(problem.patch_frame, pass.network, group, group + 1, scratch[static_cast<std::size_t>(omp_get_thread_num())].data());
  }
}

void PatchNewton::Parts::solve_frame(ConstPositions reference) {
  problem.begin({now, before, before_that, reference_before, reference_now, reference}, beta);
  double residual_before = -1.0;  // of the pass before, where a network made its step
  for (const PackedPass& pass : passes) {
    double left = problem.assemble();
    if (residual_before >= 0.0 && !(left <= tolerated_growth * residual_before)) {
      problem.go_back_and_move_along_direction();
      left = problem.assemble();
    }
    residual_before = -1.0;
    if (!(left >= nothing_left)) continue;
    problem.solve(pass.iterations);
    if (pass.columns.empty()) {
      problem.move_along_direction();
      continue;
    }
    problem.save();
    predict(pass);
    problem.move(problem.steps.data());
    residual_before = left;
  }
  if (!problem.finite()) problem.start_over();
  problem.write_estimate(next);
}

PatchNewton::PatchNewton(const NewtonBody& body, const NewtonSchedule& schedule)
    : parts_(std::make_unique<Parts>(body, schedule)) {}
PatchNewton::~PatchNewton() = default;
PatchNewton::PatchNewton(PatchNewton&&) noexcept = default;
PatchNewton& PatchNewton::operator=(PatchNewton&&) noexcept = default;

Eigen::Index PatchNewton::vertex_count() const { return parts_->problem.count; }
Eigen::Index PatchNewton::free_vertex_count() const { return parts_->problem.free_count; }
Eigen::Index PatchNewton::edge_count() const { return static_cast<Eigen::Index>(parts_->problem.edge_rows.size()); }
double PatchNewton::multiply_adds() const { return parts_->cost; }
double PatchNewton::edge_length() const { return parts_->problem.edge_length; }
const Vector& PatchNewton::stiffness() const { return parts_->problem.stiffness; }

void PatchNewton::reset(ConstPositions reference) {
  Parts& p = *parts_;
  require_rows("reference", reference.rows(), p.problem.count);
  require_finite("reference", reference);
  p.now = reference;
  for (Positions* array : {&p.before, &p.before_that, &p.reference_now, &p.reference_before}) *array = p.now;
  const auto threads = static_cast<std::size_t>(omp_get_max_threads());
  while (p.scratch.size() < threads) p.scratch.emplace_back(p.scratch_size());
  p.frames = 0;
}

const Positions& PatchNewton::step(ConstPositions reference, const Positions* /*next_reference*/) {
  Parts& p = *parts_;
  if (p.frames < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), p.problem.count);
  require_finite("reference", reference);
  p.solve_frame(reference);
  p.reference_before = reference;
  p.reference_before.swap(p.reference_now);
  p.before_that.swap(p.before);
  p.before.swap(p.now);
  p.now.swap(p.next);
  ++p.frames;
  return p.now;
}

SolverState PatchNewton::state() const {
  const Parts& p = *parts_;
  return {{p.now, p.before, p.before_that, p.reference_now, p.reference_before}, {p.frames}};
}

void PatchNewton::restore(const SolverState& state) {
  Parts& p = *parts_;
  if (state.arrays.size() != 5 || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) +
                                    " counters, expected 5 and 1 as PatchNewton.state gives them");
  }
  const Eigen::Index rows = state.counters[0] < 0 ? 0 : p.problem.count;
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), rows);
    require_finite("state", array);
  }
  if (rows) reset(state.arrays[0]);
  Positions* arrays[] = {&p.now, &p.before, &p.before_that, &p.reference_now, &p.reference_before};
  for (std::size_t k = 0; k < state.arrays.size(); ++k) *arrays[k] = state.arrays[k];
  p.frames = state.counters[0];
}

}  // namespace followthrough
