// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/implicit_euler.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "elastic/block_matrix.hpp"
#include "elastic/conjugate_gradients.hpp"
#include "elastic/sparse_cholesky.hpp"
#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

// Residuals below what moving every vertex by this share of an edge would cause count as none: at rest all forces are round-off.
constexpr double smallest_move = 1e-11;
// Armijo's constant: share of the predicted decrease that a step must bring.
constexpr double sufficient_decrease = 1e-4;
constexpr int most_halvings = 12;
// An iteration that leaves less than this share of the residual is near the end; so many are far from it at most: the convex
// tangent converges, but slowly where stresses are large.
constexpr double near_gain = 0.2;
constexpr int most_far_iterations = 3;
// What a factorization takes for each multiplication and each vertex, and an iteration for each number of the factor.
constexpr double multiplication_nanoseconds = 0.04, row_nanoseconds = 900, solve_nanoseconds = 0.4;

void require_number(const char* name, double value, bool zero_allowed) {
  if (!(std::isfinite(value) && (value > 0 || (zero_allowed && value == 0)))) {
    throw InvalidInput(name, "found " + std::to_string(value) +
                                 (zero_allowed ? ", expected a finite number, 0 or more" : ", expected a finite number above 0"));
  }
}

// Positions that a step tries, with all that is known there.
struct Trial {
  Positions positions;
  double energy = std::numeric_limits<double>::infinity();  // incremental potential, J s^2
  Vector residual;                                          // its gradient at the free vertices, kg m
  double size = 0;                                          // of the residual, weighted by 1 / mass
  double relative = 0;                                      // of the residual, against its parts

  bool finite() const { return std::isfinite(energy) && std::isfinite(size) && std::isfinite(relative); }
};

}  // namespace

struct ImplicitEuler::Parts {
  ElasticBody body;
  std::shared_ptr<const Material> material;
  double dt;
  NewtonSettings newton;
  ExternalForces forces;
  std::vector<Index> rows, free;          // row of every vertex or -1; vertex of every row
  BlockMatrix matrix, constant, damping;  // constant: mass, its damping, and pins
  SparseCholesky factor;
  BlockPreconditioner fallback;
  Positions positions, before, reference;
  std::int64_t frames = -1;  // since the reset; -1: never reset
  StepReport report;
};

// One step while it is being solved.
class ImplicitEuler::Step {
 public:
  Step(Parts& parts, ConstPositions reference, const ConstPositions* prediction)
      : p_(parts), reference_(reference), prediction_(prediction) {
    const double square = p_.dt * p_.dt;
    inertial_ = 2 * p_.positions - p_.before;
    inertial_.rowwise() += square * p_.forces.gravity.transpose();
    if (p_.forces.stiffness_damping > 0) {
      p_.damping.set_zero();
      p_.body.add_stiffness(p_.positions, *p_.material, Definiteness::kSemidefinite, p_.dt * p_.forces.stiffness_damping,
                            p_.damping);
    }
  }

  Positions solve();

 private:
  Trial evaluate(Positions positions) const;
  Trial start() const;
  bool within_tolerance(const Trial& trial) const { return trial.relative <= p_.newton.tolerance; }
  void assemble(const Positions& positions, Definiteness definiteness) const;
  std::optional<Vector> direction(const Trial& from, double linear_tolerance, Definiteness definiteness);
  int iterations_worth_a_factor() const;
  bool advance(Trial& trial, const Vector& direction) const;

  Parts& p_;
  bool factored_ = false;
  int linear_iterations_ = 0;  // of the last solve
  ConstPositions reference_;
  const ConstPositions* prediction_;  // null: none
  Positions inertial_;
};

// The incremental potential 1/2 (x - y) M (x - y) + dt^2 W(x) + ..., whose minimum is the step.
Trial ImplicitEuler::Step::evaluate(Positions positions) const {
  Trial trial;
  const double square = p_.dt * p_.dt;
  double elastic_energy = 0;
  const Positions elastic = p_.body.internal_forces(positions, *p_.material, &elastic_energy);
  const Positions away = positions - inertial_;
  const Positions inertia = p_.body.mass_product(away);
  trial.energy = 0.5 * away.cwiseProduct(inertia).sum() + square * elastic_energy;
  Positions rest = Positions::Zero(positions.rows(), 3);  // all other forces
  const Positions moved = positions - p_.positions;
  if (p_.forces.mass_damping > 0) rest += p_.dt * p_.forces.mass_damping * p_.body.mass_product(moved);
  if (p_.forces.stiffness_damping > 0) {
    rest += p_.dt * p_.forces.stiffness_damping *
            p_.body.stiffness_product(p_.positions, moved, *p_.material, Definiteness::kSemidefinite);
  }
  trial.energy += 0.5 * moved.cwiseProduct(rest).sum();
  if (p_.forces.pin_stiffness.size() > 0) {
    const Positions lag = positions - reference_;
    const Positions pull = square * (p_.forces.pin_stiffness.asDiagonal() * lag);
    trial.energy += 0.5 * lag.cwiseProduct(pull).sum();
    rest += pull;
  }
  const auto rows = static_cast<Eigen::Index>(p_.free.size());
  trial.residual.resize(3 * rows);
  double inertia_size = 0, elastic_size = 0, rest_size = 0, floor = 0;
  for (Eigen::Index row = 0; row < rows; ++row) {
    const Index v = p_.free[row];
    trial.residual.segment<3>(3 * row) = (inertia.row(v) + square * elastic.row(v) + rest.row(v)).transpose();
    const double mass = p_.body.lumped_mass()[v];
    trial.size += trial.residual.segment<3>(3 * row).squaredNorm() / mass;
    inertia_size += inertia.row(v).squaredNorm();
    elastic_size += elastic.row(v).squaredNorm();
    rest_size += rest.row(v).squaredNorm();
    floor += mass * mass;
  }
  trial.size = std::sqrt(trial.size);
  const double edge = p_.body.edge_length();
  const double parts = std::sqrt(inertia_size) + square * std::sqrt(elastic_size) + std::sqrt(rest_size);
  // Converged is a residual below tolerance * parts, or one that is round-off.
  trial.relative = trial.residual.norm() / std::max(parts, std::sqrt(floor) * edge * smallest_move / p_.newton.tolerance);
  trial.positions = std::move(positions);
  return trial;
}

Trial ImplicitEuler::Step::start() const {
  const Positions skinned = p_.positions + reference_ - p_.reference;
  const auto from = [&](const auto& row) {
    Positions positions = reference_;
    for (const Index v : p_.free) positions.row(v) = row(v);
    return evaluate(std::move(positions));
  };
  Trial best = from([&](Index v) { return Eigen::RowVector3d(0.5 * (inertial_.row(v) + skinned.row(v))); });
  if (prediction_) {
    Trial trial = from([&](Index v) { return Eigen::RowVector3d(prediction_->row(v)); });
    if (trial.finite() && !(best.energy < trial.energy)) return trial;
  }
  // The mean is usually the best start. Where the reference jumps it is not.
  for (const ConstPositions& other : {ConstPositions(skinned), ConstPositions(reference_)}) {
    Trial trial = from([&](Index v) { return Eigen::RowVector3d(other.row(v)); });
    if (trial.finite() && !(best.energy <= trial.energy)) best = std::move(trial);
  }
  return best;
}

void ImplicitEuler::Step::assemble(const Positions& positions, Definiteness definiteness) const {
  p_.matrix.copy_values(p_.constant);
  p_.body.add_stiffness(positions, *p_.material, definiteness, p_.dt * p_.dt, p_.matrix);
  if (p_.forces.stiffness_damping > 0) p_.matrix.add(p_.damping);
}

// Newton's direction; none where the matrix turns out to be indefinite.
std::optional<Vector> ImplicitEuler::Step::direction(const Trial& from, double linear_tolerance, Definiteness definiteness) {
  assemble(from.positions, definiteness);
  const Vector right = -from.residual;
  Vector result;
  const auto solved = [&](const Preconditioner& preconditioner, int most_iterations) {
    const LinearReport linear = followthrough::solve(p_.matrix, preconditioner, right, linear_tolerance, most_iterations, result);
    p_.report.linear_iterations += linear.iterations;
    linear_iterations_ = linear.iterations;
    return linear;
  };
  // An earlier factor will do as long as the iterations that it costs take less time than a new one.
  if (factored_ && linear_iterations_ <= iterations_worth_a_factor() / 2) {
    const LinearReport linear = solved(p_.factor, iterations_worth_a_factor());
    if (linear.negative_curvature) return std::nullopt;
    if (linear.converged) return result;
  }
  factored_ = p_.factor.compute(p_.matrix);
  if (!factored_) {
    if (definiteness == Definiteness::kSymmetric) return std::nullopt;
    p_.fallback.compute(p_.matrix);  // definite, but not in single precision
  }
  const LinearReport linear =
      factored_ ? solved(p_.factor, p_.newton.most_linear_iterations) : solved(p_.fallback, p_.newton.most_linear_iterations);
  if (linear.negative_curvature) return std::nullopt;
  return result;
}

int ImplicitEuler::Step::iterations_worth_a_factor() const {
  const double factor = p_.factor.work() * multiplication_nanoseconds + static_cast<double>(p_.free.size()) * row_nanoseconds;
  return static_cast<int>(factor / (static_cast<double>(p_.factor.size()) * solve_nanoseconds));
}

// Takes as much of a direction as helps; false where nothing does.
bool ImplicitEuler::Step::advance(Trial& trial, const Vector& direction) const {
  const double slope = trial.residual.dot(direction);
  double share = 1;
  for (int halving = 0; halving <= most_halvings; ++halving, share /= 2) {
    Positions positions = trial.positions;
    for (std::size_t row = 0; row < p_.free.size(); ++row) {
      positions.row(p_.free[row]) += share * direction.segment<3>(3 * static_cast<Eigen::Index>(row)).transpose();
    }
    Trial next = evaluate(std::move(positions));
    if (!next.finite()) continue;
    const bool downhill = slope < 0 && next.energy <= trial.energy + sufficient_decrease * share * slope;
    // Near the end energies differ by less than their round-off, and beyond the material's clamp they are not its own.
    const bool level = next.energy <= trial.energy + 1e-9 * std::abs(trial.energy);
    if (downhill || (level && next.size <= (1 - 0.1 * share) * trial.size)) {
      trial = std::move(next);
      return true;
    }
  }
  return false;
}

Positions ImplicitEuler::Step::solve() {
  Trial trial = start();
  double linear_tolerance = 0.1;
  // The exact tangent leads home fastest from nearby. Far away it is mostly indefinite, and the convex one points downhill.
  bool near = false;
  StepReport& report = p_.report;
  report = {};
  while (!within_tolerance(trial) && report.iterations < p_.newton.most_iterations) {
    const double before = trial.size;
    ++report.iterations;
    bool advanced = false;
    for (const bool exact : {near, !near}) {
      const auto newton = direction(trial, linear_tolerance, exact ? Definiteness::kSymmetric : Definiteness::kConvex);
      advanced = newton && advance(trial, *newton);
      if (advanced) break;
    }
    if (!advanced) break;
    const double gain = trial.size / before;
    near = gain < near_gain || report.iterations >= most_far_iterations;
    // As exact as Newton's method will converge, but no better than the step needs.
    linear_tolerance = std::clamp(0.5 * gain * gain, 1e-6, 0.1);
    linear_tolerance = std::max(linear_tolerance, std::min(0.3 * p_.newton.tolerance / trial.relative, 0.1));
  }
  report.residual = trial.relative;
  report.converged = within_tolerance(trial);
  return std::move(trial.positions);
}

ImplicitEuler::ImplicitEuler(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained, double dt,
                             const NewtonSettings& newton, const ExternalForces& forces) {
  const Eigen::Index count = body.vertex_count();
  require_rows("constrained", constrained.size(), count);
  require_number("dt", dt, false);
  require_number("tolerance", newton.tolerance, false);
  require_number("mass_damping", forces.mass_damping, true);
  require_number("stiffness_damping", forces.stiffness_damping, true);
  require_finite("gravity", forces.gravity.transpose());
  if (forces.pin_stiffness.size() > 0) {
    require_rows("pin_stiffness", forces.pin_stiffness.size(), count);
    for (Eigen::Index v = 0; v < count; ++v) require_number("pin_stiffness", forces.pin_stiffness[v], true);
  }
  std::vector<Index> rows(static_cast<std::size_t>(count), -1), free;
  for (Eigen::Index v = 0; v < count; ++v) {
    if (constrained[v] || body.lumped_mass()[v] == 0) continue;
    rows[v] = static_cast<Index>(free.size());
    free.push_back(static_cast<Index>(v));
  }
  if (free.empty()) throw InvalidInput("constrained", "found no free vertex, expected at least one");
  const BlockMatrix empty(body.corners(), rows);
  BlockMatrix constant = empty;
  body.add_mass(1 + dt * forces.mass_damping, constant);
  if (forces.pin_stiffness.size() > 0) {
    for (std::size_t row = 0; row < free.size(); ++row) {
      constant.add_to_diagonal(static_cast<Eigen::Index>(row),
                               dt * dt * forces.pin_stiffness[free[row]] * BlockMatrix::Block::Identity());
    }
  }
  parts_ = std::make_unique<Parts>(Parts{body,
                                         std::move(material),
                                         dt,
                                         newton,
                                         forces,
                                         std::move(rows),
                                         std::move(free),
                                         empty,
                                         std::move(constant),
                                         empty,
                                         SparseCholesky(empty),
                                         {},
                                         {},
                                         {},
                                         {},
                                         -1,
                                         {}});
}

ImplicitEuler::~ImplicitEuler() = default;

Eigen::Index ImplicitEuler::vertex_count() const { return parts_->body.vertex_count(); }

const StepReport& ImplicitEuler::last_step() const { return parts_->report; }

void ImplicitEuler::reset(ConstPositions reference) {
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  parts_->positions = reference;
  parts_->before = parts_->positions;
  parts_->reference = parts_->positions;
  parts_->frames = 0;
  parts_->report = {};
}

const Positions& ImplicitEuler::step(ConstPositions reference, const Positions*) { return take_step(reference, nullptr); }

const Positions& ImplicitEuler::step_from(ConstPositions prediction, ConstPositions reference) {
  require_rows("prediction", prediction.rows(), vertex_count());
  return take_step(reference, &prediction);
}

const Positions& ImplicitEuler::take_step(ConstPositions reference, const ConstPositions* prediction) {
  if (parts_->frames < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  Positions after = Step(*parts_, reference, prediction).solve();
  if (!after.allFinite()) after = reference;
  parts_->before = std::move(parts_->positions);
  parts_->positions = std::move(after);
  parts_->reference = reference;
  ++parts_->frames;
  return parts_->positions;
}

SolverState ImplicitEuler::state() const { return {{parts_->positions, parts_->before, parts_->reference}, {parts_->frames}}; }

void ImplicitEuler::restore(const SolverState& state) {
  if (state.arrays.size() != 3 || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) +
                                    " counters, expected 3 and 1 as ImplicitEuler.state gives them");
  }
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), state.counters[0] < 0 ? 0 : vertex_count());
    require_finite("state", array);
  }
  parts_->positions = state.arrays[0];
  parts_->before = state.arrays[1];
  parts_->reference = state.arrays[2];
  parts_->frames = state.counters[0];
  parts_->report = {};
}

}  // namespace followthrough
