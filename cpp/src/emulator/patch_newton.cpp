// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/patch_newton.hpp"

#include <omp.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>
#include <utility>

#include "elastic/descent.hpp"
#include "elastic/local_rotations.hpp"
#include "emulator/newton_problem.hpp"
#include "emulator/packed_layers.hpp"
#include "emulator/step_guard.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

// Root mean square of the first preconditioned residual, in edges, below which a pass has nothing to do: rounding.
constexpr double nothing_left = 1e-7;
// Root mean square of the first step, in edges, from which on the tolerance is as it is given: calmer frames are solved as exactly
// in proportion, so that what comes to rest does.
constexpr double lively_step = 0.1;
// A frame whose residuals after so many passes still add up to so many edges may have several solutions. (Directions of stiff and
// thin flesh reach far beyond residuals, which says nothing of that.) It begins again where the simulation
// does, to find the one that the simulation finds, with as many passes at most.
constexpr int passes_before_doubt = 4, most_passes_again = 48;
constexpr double doubtful_error = 0.02;
// How much of the way to where inertia leads, in halves, the simulation may start from.
constexpr double least_inertia = -0.2, greatest_inertia = 2.2;

decltype(&baseline::guide_rows) guide_kernel() { return FOLLOWTHROUGH_KERNEL(guide_rows); }

void require_layer(const std::string& place, const DenseLayer& layer, Eigen::Index inputs, Eigen::Index outputs) {
  if (layer.weight.cols() != inputs || layer.weight.rows() < 1 || (outputs && layer.weight.rows() != outputs)) {
    throw InvalidInput(place + ".weight", "found " + std::to_string(layer.weight.rows()) + " x " +
                                              std::to_string(layer.weight.cols()) + ", expected " +
                                              (outputs ? std::to_string(outputs) + " rows and " : "") + std::to_string(inputs) +
                                              " columns, one an input");
  }
  if (layer.bias.size() != layer.weight.rows()) {
    throw InvalidInput(place + ".bias",
                       "found " + std::to_string(layer.bias.size()) + " numbers, expected " + std::to_string(layer.weight.rows()));
  }
  if (!layer.weight.allFinite()) throw InvalidInput(place + ".weight", "found NaN or infinity, expected finite numbers");
  if (!layer.bias.allFinite()) throw InvalidInput(place + ".bias", "found NaN or infinity, expected finite numbers");
}

void require_guide(const std::string& place, const Guide& guide, GuideSize size) {
  if (guide.empty()) throw InvalidInput(place, "found no layers, expected at least 1");
  Eigen::Index width = size.vectors * (size.vectors + 1) / 2 + size.scalars;
  for (std::size_t k = 0; k < guide.size(); ++k) {
    require_layer(place + "." + std::to_string(k), guide[k], width, k + 1 == guide.size() ? size.vectors : 0);
    width = guide[k].weight.rows();
  }
}

// A guide as the kernels take it.
struct PackedGuide {
  PackedGuide() = default;
  explicit PackedGuide(const Guide& guide) : layers(guide) {
    for (const DenseLayer& layer : layers) {
      kernels.push_back({layer.weight.data(), layer.bias.data(), static_cast<std::int32_t>(layer.weight.cols()),
                         static_cast<std::int32_t>(layer.weight.rows())});
      widest = std::max({widest, kernels.back().inputs, kernels.back().outputs});
      cost += static_cast<double>(layer.weight.size());
    }
  }

  Guide layers;
  std::vector<GuideLayer> kernels;
  std::int32_t widest = 0;
  double cost = 0;  // multiply-adds a vertex
};

std::vector<std::array<Index, 4>> corners_of(const Tets& tets) {
  std::vector<std::array<Index, 4>> corners(static_cast<std::size_t>(tets.rows()));
  for (Eigen::Index t = 0; t < tets.rows(); ++t)
    corners[static_cast<std::size_t>(t)] = {tets(t, 0), tets(t, 1), tets(t, 2), tets(t, 3)};
  return corners;
}

struct PackedPass {
  int iterations;
  PackedGuide guide;
};

// How the steps of a frame are found: as usual, or from where the simulation starts, without guides.
enum class Manner { usual, as_simulated };

// How passes come to their end: where little is left, after a step that nobody needed to look at, or in doubt whether the frame has
// several solutions.
enum class Ending { seen, unseen, doubtful };

}  // namespace

void require_schedule(const NewtonSchedule& schedule) {
  require_guide("start", schedule.start, start_guide_size());
  for (std::size_t k = 0; k < schedule.passes.size(); ++k) {
    const std::string place = "passes." + std::to_string(k);
    const NewtonPass& pass = schedule.passes[k];
    if (pass.iterations < 0) {
      throw InvalidInput(place + ".iterations", "found " + std::to_string(pass.iterations) + ", expected 0 or more");
    }
    if (!pass.guide.empty()) require_guide(place + ".guide", pass.guide, pass_guide_size());
  }
  const auto require_count = [](const char* name, int found) {
    if (found < 0) throw InvalidInput(name, "found " + std::to_string(found) + ", expected 0 or more");
  };
  require_count("most_passes", schedule.most_passes);
  require_count("extra_passes", schedule.extra_passes);
  require_count("extra_iterations", schedule.extra_iterations);
  if (!(std::isfinite(schedule.tolerance) && schedule.tolerance >= 0.0)) {
    throw InvalidInput("tolerance", "found " + std::to_string(schedule.tolerance) + ", expected 0 edges or more");
  }
}

struct PatchNewton::Parts {
  Parts(const NewtonBody& body, const NewtonSchedule& schedule);
  void take_guided_step(const PackedGuide& guide, bool of_pass);
  Ending take_passes(int count, const PackedPass* first, std::size_t different, double enough, Manner manner);
  Ending take_all_passes(ConstPositions next_reference, double enough, Manner& manner);
  void start_as_simulated(ConstPositions next_reference);
  void solve_frame(ConstPositions reference);

  NewtonProblem problem;
  StepGuard guard;
  LocalRotations rotations;
  PackedGuide start;
  std::vector<PackedPass> passes;
  PackedPass extra;
  int most_passes, extra_passes;
  double tolerance;
  std::vector<AlignedFloats> scratch;  // one a thread
  double cost = 0;
  std::array<Positions, 4> dynamic;    // u(t), u(t-1), u(t-2), u(t-3)
  std::array<Positions, 3> reference;  // x(t), x(t-1), x(t-2)
  Positions next;                      // u(t+1)
  std::int64_t frames = -1;            // since the reset; -1: never reset
};

PatchNewton::Parts::Parts(const NewtonBody& body, const NewtonSchedule& schedule)
    : problem((require_schedule(schedule), body)),
      guard(problem),
      rotations(corners_of(body.tets), problem.count, problem.free_vertices),
      start(schedule.start),
      extra{schedule.extra_iterations, {}},
      most_passes(schedule.passes.empty() ? 0 : schedule.most_passes),
      extra_passes(schedule.extra_passes),
      tolerance(schedule.tolerance) {
  const auto edges = static_cast<double>(problem.edge_rows.size()), frees = static_cast<double>(problem.free_count);
  cost = start.cost * frees;
  for (const NewtonPass& pass : schedule.passes) {
    passes.push_back({pass.iterations, PackedGuide(pass.guide)});
    cost += passes.back().guide.cost * frees + 9.0 * pass.iterations * (edges + frees);
  }
  next = Positions::Zero(problem.count, 3);
}

void PatchNewton::Parts::take_guided_step(const PackedGuide& guide, bool of_pass) {
  const auto kernel = guide_kernel();
  const GuideKernel network{guide.kernels.data(), static_cast<std::int32_t>(guide.kernels.size()), guide.widest};
  const GuideInputs inputs = of_pass ? problem.pass_inputs() : problem.start_inputs();
  const int threads = std::min(problem.threads(30.0 + 0.03 * guide.cost), static_cast<int>(scratch.size()));
#pragma omp parallel num_threads(threads)
  {
    if (of_pass) {
      const TeamShare rows(problem.row_count);
      for (std::int32_t row = rows.first; row < rows.last; ++row) problem.record(row);
      problem.barrier.wait();
    }
    float* const room = scratch[static_cast<std::size_t>(omp_get_thread_num())].data();
    const TeamShare groups(problem.groups);
    for (std::int32_t group = groups.first; group < groups.last; ++group) {
      problem.describe(inputs, group);
      kernel(inputs, network, group, group + 1, room);
      problem.move_group(inputs.steps, group);
    }
  }
  problem.have_moved(inputs.steps, of_pass);
}

// The last of the different passes is repeated. Where a frame has begun again, a first pass shows how far its direction reaches,
// and guides, which know little of such frames, have no say.
Ending PatchNewton::Parts::take_passes(int count, const PackedPass* first, std::size_t different, double enough, Manner manner) {
  const bool usual = manner == Manner::usual;
  double reach = 1.0, expected = std::numeric_limits<double>::infinity();
  for (int k = 0; k < count; ++k) {
    const double left = guard.evaluate(guard.tangent(expected));
    expected = guard.expected_error(reach);
    if (!(left >= nothing_left)) break;
    if (!(expected >= enough || (!usual && k == 0))) break;
    if (usual && k == passes_before_doubt && guard.expected_error(1.0) >= doubtful_error) return Ending::doubtful;
    const PackedPass& pass = first[std::min(static_cast<std::size_t>(k), different - 1)];
    problem.solve(guard.iterations(pass.iterations), guard.tolerance());
    guard.has_solved(pass.iterations);
    reach = problem.direction_length() / left;
    if (guard.ends_frame(reach, enough)) {
      problem.move_along_direction();
      return Ending::unseen;
    }
    const bool guided = usual && !pass.guide.layers.empty() && guard.guided();
    guard.before_step(guided, k + 1 == count);
    if (guided) {
      take_guided_step(pass.guide, true);
    } else {
      problem.move_along_direction();
    }
  }
  return Ending::seen;
}

// The best of: the last offset from the reference, turned as the reference turns; half way from there to where inertia leads; where
// the cubic through the energy at those two is least; the reference itself.
void PatchNewton::Parts::start_as_simulated(ConstPositions next_reference) {
  Positions turned = dynamic[0] - reference[0];
  rotations.turn(reference[0], next_reference, turned);
  turned += next_reference;
  problem.go_to(turned);
  problem.assemble(Tangent::convex);
  const double energy = problem.energy;
  const auto padded = static_cast<std::ptrdiff_t>(problem.padded);
  for (std::int32_t row = 0; row < problem.free_count; ++row) {
    for (int k = 0; k < 3; ++k) {
      const std::size_t place = 3 * static_cast<std::size_t>(row) + static_cast<std::size_t>(k);
      problem.solution.data()[k * padded + row] = static_cast<float>(0.5 * (problem.inertial[place] - problem.positions[place]));
    }
  }
  problem.save();
  const double slope = problem.slope_along_saved();
  double best = energy, best_share = 0.0;
  const auto consider = [&](double share) {
    problem.go_back_and_move(share);
    problem.assemble(Tangent::convex);
    if (best <= problem.energy) return;
    best = problem.energy;
    best_share = share;
  };
  consider(1.0);
  const double least = cubic_minimum(energy, slope, problem.energy, problem.slope_along_saved());
  if (std::isfinite(least)) consider(std::clamp(least, least_inertia, greatest_inertia));
  problem.go_to_reference(std::vector<bool>(problem.island_count, true));
  problem.assemble(Tangent::convex);
  if (problem.energy < best) return;
  problem.go_back_and_move(best_share);
  std::fill_n(problem.motion.data(), 3 * padded, 0.0f);
}

Ending PatchNewton::Parts::take_all_passes(ConstPositions next_reference, double enough, Manner& manner) {
  Ending ending = take_passes(most_passes, passes.data(), passes.size(), enough, manner);
  if (ending == Ending::doubtful) {
    manner = Manner::as_simulated;
    start_as_simulated(next_reference);
    guard.begin_again();
    ending = take_passes(most_passes_again, passes.data(), passes.size(), enough, manner);
  }
  if (extra_passes > 0) ending = take_passes(extra_passes, &extra, 1, nothing_left, manner);
  guard.end();
  return ending;
}

void PatchNewton::Parts::solve_frame(ConstPositions next_reference) {
  problem.begin({{dynamic[0], dynamic[1], dynamic[2], dynamic[3]}, {next_reference, reference[0], reference[1], reference[2]}});
  guard.begin();
  take_guided_step(start, false);
  double square = 0;
  for (int k = 0; k < 3; ++k) {
    const float* step = problem.steps.data() + k * static_cast<std::ptrdiff_t>(problem.padded);
    for (std::int32_t row = 0; row < problem.free_count; ++row) square += static_cast<double>(step[row]) * step[row];
  }
  const double liveliness = std::min(1.0, std::sqrt(square / (3.0 * std::max(problem.free_count, 1))) / lively_step);
  const double enough = std::max(tolerance * liveliness, nothing_left);
  Manner manner = Manner::usual;
  const bool seen = take_all_passes(next_reference, enough, manner) != Ending::unseen && most_passes + extra_passes > 0;
  if (seen && guard.go_to_better_reference()) take_all_passes(next_reference, enough, manner);
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
  for (Positions& array : p.dynamic) array = reference;
  for (Positions& array : p.reference) array = reference;
  const auto threads = static_cast<std::size_t>(omp_get_max_threads());
  std::int32_t widest = p.start.widest;
  for (const PackedPass& pass : p.passes) widest = std::max(widest, pass.guide.widest);
  while (p.scratch.size() < threads) p.scratch.emplace_back(2 * static_cast<std::size_t>(widest) * kNewtonGroup);
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
  for (std::size_t k = p.reference.size() - 1; k > 0; --k) p.reference[k].swap(p.reference[k - 1]);
  p.reference[0] = reference;
  for (std::size_t k = p.dynamic.size() - 1; k > 0; --k) p.dynamic[k].swap(p.dynamic[k - 1]);
  p.dynamic[0].swap(p.next);
  ++p.frames;
  return p.dynamic[0];
}

SolverState PatchNewton::state() const {
  const Parts& p = *parts_;
  SolverState state{{}, {p.frames}};
  state.arrays.insert(state.arrays.end(), p.dynamic.begin(), p.dynamic.end());
  state.arrays.insert(state.arrays.end(), p.reference.begin(), p.reference.end());
  return state;
}

void PatchNewton::restore(const SolverState& state) {
  Parts& p = *parts_;
  const std::size_t expected = p.dynamic.size() + p.reference.size();
  if (state.arrays.size() != expected || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) + " counters, expected " + std::to_string(expected) +
                                    " and 1 as PatchNewton.state gives them");
  }
  const Eigen::Index rows = state.counters[0] < 0 ? 0 : p.problem.count;
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), rows);
    require_finite("state", array);
  }
  if (rows) reset(state.arrays[0]);
  std::copy_n(state.arrays.begin(), p.dynamic.size(), p.dynamic.begin());
  std::copy_n(state.arrays.begin() + static_cast<std::ptrdiff_t>(p.dynamic.size()), p.reference.size(), p.reference.begin());
  p.frames = state.counters[0];
}

}  // namespace followthrough
