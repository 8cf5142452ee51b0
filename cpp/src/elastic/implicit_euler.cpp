// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/implicit_euler.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>

#include "elastic/block_matrix.hpp"
#include "elastic/compact_order.hpp"
#include "elastic/conjugate_gradients.hpp"
#include "elastic/descent.hpp"
#include "elastic/element_batch.hpp"
#include "elastic/lane_system.hpp"
#include "elastic/local_rotations.hpp"
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
// What a factorization takes for each multiplication and each vertex; and an iteration for each number of the factor, each block of
// the matrix and each vertex. Fixed numbers rather than a clock, so that results are the same everywhere.
constexpr double multiplication_nanoseconds = 0.04, row_nanoseconds = 900;
constexpr double solve_nanoseconds = 0.3, block_nanoseconds = 10, vector_nanoseconds = 30, lane_block_nanoseconds = 2.5;
// Iterations with the diagonal for each e-fold of the residual and each unit of the condition number's root: measured on soft and
// stiff bodies of 1,500 and 7,700 vertices, rounded down, as a factor is still there when they turn out to be more.
constexpr double iterations_a_root = 0.1;
// Conjugate gradients get so many iterations at least: a few too many cost less than a factor for one direction.
constexpr int fewest_iterations = 300;
// What is left of a Newton system's residual: loosest, tightest. In single precision exactness is cheap, as an iteration of
// Newton's method costs as much as twenty of conjugate gradients, but has fewer digits.
struct LinearTolerances {
  double loosest, tightest;
};
constexpr LinearTolerances single_tolerances{0.03, 1e-4}, factored_tolerances{0.1, 1e-6};
// Where Newton's method takes longer than this, something is crushed, and the last digits of directions count.
constexpr int most_single_iterations = 10;
// How much of the way to where inertia leads, in halves, a step may start from.
constexpr double least_inertia = -0.2, greatest_inertia = 2.2;

void require_number(const char* name, double value, bool zero_allowed) {
  if (!(std::isfinite(value) && (value > 0 || (zero_allowed && value == 0)))) {
    throw InvalidInput(name, "found " + std::to_string(value) +
                                 (zero_allowed ? ", expected a finite number, 0 or more" : ", expected a finite number above 0"));
  }
}

// Room for an evaluation, so that none allocates.
struct Evaluation {
  explicit Evaluation(Eigen::Index count)
      : positions(static_cast<std::size_t>(count)), away(positions), elastic(positions), inertia(positions) {}
  PaddedPositions positions, away, elastic, inertia;
};

// The matrix in double precision and what is constant of it, made when a factor is needed for the first time.
struct Assembled {
  BlockMatrix matrix, constant;
};

// Of a step's matrix: mass, its damping, and pins.
BlockMatrix constant_part(const ElasticBody& body, double dt, const ExternalForces& forces, const std::vector<Index>& rows) {
  BlockMatrix constant(body.corners(), rows);
  body.add_mass(1 + dt * forces.mass_damping, constant);
  for (Eigen::Index v = 0; v < forces.pin_stiffness.size(); ++v) {
    if (rows[v] >= 0) constant.add_to_diagonal(rows[v], dt * dt * forces.pin_stiffness[v] * BlockMatrix::Block::Identity());
  }
  return constant;
}

Eigen::RowVector3d row_of(const PaddedPositions& all, Index v) { return {all[v].x, all[v].y, all[v].z}; }

}  // namespace

struct ImplicitEuler::Parts {
  ElasticBody body;
  std::shared_ptr<const Material> material;
  double dt;
  NewtonSettings newton;
  ExternalForces forces;
  std::vector<Index> rows, free;  // row of every vertex or -1; vertex of every row
  LaneSystem lanes;
  ElasticBody::Selection selection;       // as the lanes' parts need them
  std::vector<float> stiffness, damping;  // of all elements; none, mostly: only without a closed form, and with damping
  SparseCholesky factor;
  std::optional<Assembled> assembled;
  BlockDiagonal diagonal;
  Evaluation evaluation;
  LocalRotations rotations;
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
      p_.damping.resize(p_.body.stiffness_size());
      pad(p_.positions);
      p_.body.element_stiffness(p_.evaluation.positions, *p_.material, Definiteness::kSemidefinite,
                                p_.dt * p_.forces.stiffness_damping * p_.lanes.unit(), p_.damping);
    }
  }

  Positions solve();

 private:
  void pad(const Positions& positions) const;
  Trial evaluate(Positions positions) const;
  Trial start() const;
  bool within_tolerance(const Trial& trial) const { return trial.relative <= p_.newton.tolerance; }
  bool assemble_lanes(const Positions& positions, Definiteness definiteness);
  const BlockMatrix& assemble(const Positions& positions, Definiteness definiteness) const;
  std::optional<Vector> direction(const Trial& from, double linear_tolerance, Definiteness definiteness);
  double factor_iteration() const;
  double lane_iteration() const;
  int iterations_worth_a_factor(double iteration_nanoseconds) const;
  double expected_iterations(double linear_tolerance) const;
  bool advance(Trial& trial, const Vector& direction) const;

  Parts& p_;
  bool factored_ = false, iterative_ = true;
  bool coarse_made_ = false;   // for this step: its first one serves all iterations, so that states resume
  int linear_iterations_ = 0;  // of the last solve
  ConstPositions reference_;
  const ConstPositions* prediction_;  // null: none
  Positions inertial_;
};

// The incremental potential 1/2 (x - y) M (x - y) + dt^2 W(x) + ..., whose minimum is the step.
Trial ImplicitEuler::Step::evaluate(Positions positions) const {
  Trial trial;
  const double square = p_.dt * p_.dt;
  Evaluation& at = p_.evaluation;
  for (std::size_t v = 0; v < at.positions.size(); ++v) {
    const auto row = static_cast<Eigen::Index>(v);
    const Eigen::RowVector3d away = positions.row(row) - inertial_.row(row);
    at.positions[v] = {positions(row, 0), positions(row, 1), positions(row, 2), 0};
    at.away[v] = {away.x(), away.y(), away.z(), 0};
    at.elastic[v] = {};
    at.inertia[v] = {};
  }
  double elastic_energy = 0;
  p_.body.add_internal_forces(at.positions, *p_.material, square, at.elastic, &elastic_energy);
  p_.body.add_mass_product(at.away, at.inertia);
  for (std::size_t v = 0; v < at.away.size(); ++v) {
    const Padded<double>&away = at.away[v], &inertia = at.inertia[v];
    trial.energy += 0.5 * (away.x * inertia.x + away.y * inertia.y + away.z * inertia.z);
  }
  trial.energy += square * elastic_energy;
  Positions rest;  // all other forces; none, mostly
  const auto others = [&]() -> Positions& {
    if (rest.rows() == 0) rest.setZero(positions.rows(), 3);
    return rest;
  };
  if (p_.forces.mass_damping > 0 || p_.forces.stiffness_damping > 0) {
    const Positions moved = positions - p_.positions;
    if (p_.forces.mass_damping > 0) others() += p_.dt * p_.forces.mass_damping * p_.body.mass_product(moved);
    if (p_.forces.stiffness_damping > 0) {
      others() += p_.dt * p_.forces.stiffness_damping *
                  p_.body.stiffness_product(p_.positions, moved, *p_.material, Definiteness::kSemidefinite);
    }
    trial.energy += 0.5 * moved.cwiseProduct(rest).sum();
  }
  if (p_.forces.pin_stiffness.size() > 0) {
    const Positions lag = positions - reference_;
    const Positions pull = square * (p_.forces.pin_stiffness.asDiagonal() * lag);
    trial.energy += 0.5 * lag.cwiseProduct(pull).sum();
    others() += pull;
  }
  const auto rows = static_cast<Eigen::Index>(p_.free.size());
  trial.residual.resize(3 * rows);
  double inertia_size = 0, elastic_size = 0, rest_size = 0, floor = 0;
  for (Eigen::Index row = 0; row < rows; ++row) {
    const Index v = p_.free[row];
    const Eigen::RowVector3d inertia = row_of(at.inertia, v), elastic = row_of(at.elastic, v);
    Eigen::RowVector3d force = inertia + elastic;
    if (rest.rows() > 0) {
      force += rest.row(v);
      rest_size += rest.row(v).squaredNorm();
    }
    trial.residual.segment<3>(3 * row) = force.transpose();
    const double mass = p_.body.lumped_mass()[v];
    trial.size += force.squaredNorm() / mass;
    inertia_size += inertia.squaredNorm();
    elastic_size += elastic.squaredNorm();
    floor += mass * mass;
  }
  trial.size = std::sqrt(trial.size);
  const double edge = p_.body.edge_length();
  const double parts = std::sqrt(inertia_size) + std::sqrt(elastic_size) + std::sqrt(rest_size);
  // Converged is a residual below tolerance * parts, or one that is round-off.
  trial.relative = trial.residual.norm() / std::max(parts, std::sqrt(floor) * edge * smallest_move / p_.newton.tolerance);
  trial.positions = std::move(positions);
  return trial;
}

// A prediction, where there is one and it is no worse than the first of the others. Else the best of three: the last offset from
// the reference, turned as the reference turns; between it and where inertia leads, which is where the cubic through the potential
// at the one and half way to the other is least; and the reference itself, for offsets that have nothing to say any more.
Trial ImplicitEuler::Step::start() const {
  Positions offset = p_.positions - p_.reference;
  p_.rotations.turn(p_.reference, reference_, offset);
  Positions turned = reference_;
  Vector half_way(3 * static_cast<Eigen::Index>(p_.free.size()));
  for (std::size_t row = 0; row < p_.free.size(); ++row) {
    const Index v = p_.free[row];
    turned.row(v) += offset.row(v);
    half_way.segment<3>(3 * static_cast<Eigen::Index>(row)) = 0.5 * (inertial_.row(v) - turned.row(v)).transpose();
  }
  Trial best = evaluate(std::move(turned));
  if (prediction_) {
    Positions predicted = reference_;
    for (const Index v : p_.free) predicted.row(v) = prediction_->row(v);
    Trial trial = evaluate(std::move(predicted));
    if (trial.finite() && !(best.energy < trial.energy)) return trial;
  }
  const auto consider = [&](Trial trial) {
    if (trial.finite() && !(best.energy <= trial.energy)) best = std::move(trial);
  };
  const Trial first = best;
  Trial second = evaluate(moved(first, half_way, 1, p_.free));
  const double share = cubic_minimum(first.energy, first.residual.dot(half_way), second.energy, second.residual.dot(half_way));
  consider(std::move(second));
  if (std::isfinite(share)) consider(evaluate(moved(first, half_way, std::clamp(share, least_inertia, greatest_inertia), p_.free)));
  consider(evaluate(reference_));
  return best;
}

void ImplicitEuler::Step::pad(const Positions& positions) const {
  PaddedPositions& padded = p_.evaluation.positions;
  for (std::size_t v = 0; v < padded.size(); ++v) {
    const auto row = static_cast<Eigen::Index>(v);
    padded[v] = {positions(row, 0), positions(row, 1), positions(row, 2), 0};
  }
}

// False where the matrix is not positive definite for certain.
bool ImplicitEuler::Step::assemble_lanes(const Positions& positions, Definiteness definiteness) {
  pad(positions);
  const double scale = p_.dt * p_.dt * p_.lanes.unit();
  const PaddedPositions& at = p_.evaluation.positions;
  const bool closed_form = ElasticBody::has_closed_stiffness(*p_.material, definiteness);
  if (!closed_form) {
    p_.stiffness.resize(p_.body.stiffness_size());
    p_.body.element_stiffness(at, *p_.material, definiteness, scale, p_.stiffness);
  }
  const auto fill = [&](std::size_t part, float* to) {
    const std::size_t first = p_.lanes.part_starts()[part], last = p_.lanes.part_starts()[part + 1];
    if (closed_form) p_.body.element_stiffness(p_.selection, first, last, at, *p_.material, definiteness, scale, to);
    for (std::size_t k = first; k < last; ++k, to += stiffness_floats) {
      const std::size_t from = static_cast<std::size_t>(p_.selection.tets[k]) * stiffness_floats;
      if (!closed_form) std::copy_n(&p_.stiffness[from], stiffness_floats, to);
      for (int c = 0; c < stiffness_floats && !p_.damping.empty(); ++c) to[c] += p_.damping[from + c];
    }
  };
  const bool definite = p_.lanes.assemble(fill, !coarse_made_);
  coarse_made_ = coarse_made_ || definite;
  return definite;
}

const BlockMatrix& ImplicitEuler::Step::assemble(const Positions& positions, Definiteness definiteness) const {
  if (!p_.assembled) {
    BlockMatrix constant = constant_part(p_.body, p_.dt, p_.forces, p_.rows);
    p_.assembled.emplace(constant, constant);
  }
  BlockMatrix& matrix = p_.assembled->matrix;
  matrix.copy_values(p_.assembled->constant);
  p_.body.add_stiffness(positions, *p_.material, definiteness, p_.dt * p_.dt, matrix);
  if (p_.forces.stiffness_damping > 0) {
    p_.body.add_stiffness(p_.positions, *p_.material, Definiteness::kSemidefinite, p_.dt * p_.forces.stiffness_damping, matrix);
  }
  return matrix;
}

// Newton's direction; none where the matrix turns out to be indefinite.
std::optional<Vector> ImplicitEuler::Step::direction(const Trial& from, double linear_tolerance, Definiteness definiteness) {
  const Vector right = -from.residual;
  Vector result;
  const auto counted = [&](const LinearReport& linear) {
    p_.report.linear_iterations += linear.iterations;
    linear_iterations_ = linear.iterations;
    return linear;
  };
  if (!factored_ && iterative_) {
    if (!assemble_lanes(from.positions, definiteness)) return std::nullopt;
    const int worthwhile = std::max(iterations_worth_a_factor(lane_iteration()), fewest_iterations);
    const int most = std::min(worthwhile, p_.newton.most_linear_iterations);
    if (expected_iterations(linear_tolerance) <= worthwhile) {
      const LinearReport linear = counted(p_.lanes.solve(right, linear_tolerance, most, result));
      if (linear.negative_curvature) return std::nullopt;
      if (linear.converged || most == p_.newton.most_linear_iterations) return result;
    }
    iterative_ = false;
  }
  const BlockMatrix& matrix = assemble(from.positions, definiteness);
  const auto solved = [&](const Preconditioner& preconditioner, int most_iterations) {
    return counted(followthrough::solve(matrix, preconditioner, right, linear_tolerance, most_iterations, result));
  };
  // An earlier factor will do as long as the iterations that it costs take less time than a new one.
  const int worthwhile = iterations_worth_a_factor(factor_iteration());
  if (factored_ && linear_iterations_ <= worthwhile / 2) {
    const LinearReport linear = solved(p_.factor, worthwhile);
    if (linear.negative_curvature) return std::nullopt;
    if (linear.converged) return result;
  }
  factored_ = p_.factor.compute(matrix);
  if (!factored_) {
    if (definiteness == Definiteness::kSymmetric) return std::nullopt;
    p_.diagonal.compute(matrix);  // definite, but not in single precision
  }
  const LinearReport linear =
      factored_ ? solved(p_.factor, p_.newton.most_linear_iterations) : solved(p_.diagonal, p_.newton.most_linear_iterations);
  if (linear.negative_curvature) return std::nullopt;
  return result;
}

double ImplicitEuler::Step::factor_iteration() const {
  return static_cast<double>(p_.factor.size()) * solve_nanoseconds +
         static_cast<double>(p_.assembled->matrix.columns().size()) * block_nanoseconds +
         static_cast<double>(p_.free.size()) * vector_nanoseconds;
}

double ImplicitEuler::Step::lane_iteration() const { return static_cast<double>(p_.lanes.slot_count()) * lane_block_nanoseconds; }

int ImplicitEuler::Step::iterations_worth_a_factor(double iteration_nanoseconds) const {
  const double factor = p_.factor.work() * multiplication_nanoseconds + static_cast<double>(p_.free.size()) * row_nanoseconds;
  return static_cast<int>(factor / iteration_nanoseconds);
}

// Of conjugate gradients with the diagonal: the stiffness beside the mass is about the condition number, whose root counts.
double ImplicitEuler::Step::expected_iterations(double linear_tolerance) const {
  return iterations_a_root * std::sqrt(p_.lanes.stiffness_ratio()) * std::log(2 / linear_tolerance);
}

// Takes as much of a direction as helps; false where nothing does.
bool ImplicitEuler::Step::advance(Trial& trial, const Vector& direction) const {
  const double slope = trial.residual.dot(direction);
  return search_along(
      trial, direction, p_.free, most_halvings, [&](Positions positions) { return evaluate(std::move(positions)); },
      [&](const Trial& next, double share) {
        if (slope < 0 && next.energy <= trial.energy + sufficient_decrease * share * slope) return true;
        if (!(next.size <= (1 - 0.1 * std::min(share, 1.0)) * trial.size)) return false;
        // Near the end energies differ by less than their round-off.
        if (next.energy <= trial.energy + 1e-9 * std::abs(trial.energy)) return true;
        // Beyond the material's clamp the forces are those of no energy, and the one that is reported would refuse good steps.
        // There the work of the forces along the step tells.
        return slope < 0 && 0.5 * share * (slope + next.residual.dot(direction)) <= sufficient_decrease * share * slope;
      });
}

Positions ImplicitEuler::Step::solve() {
  Trial trial = start();
  double linear_tolerance = single_tolerances.loosest;
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
    if (!advanced && iterative_) {  // a factor may know better
      iterative_ = false;
      continue;
    }
    if (!advanced) break;
    const double gain = trial.size / before;
    if (report.iterations >= most_single_iterations) iterative_ = false;
    near = gain < near_gain || report.iterations >= most_far_iterations;
    // As exact as Newton's method will converge, but no better than the step needs.
    const LinearTolerances& bounds = iterative_ ? single_tolerances : factored_tolerances;
    linear_tolerance = std::clamp(0.5 * gain * gain, bounds.tightest, bounds.loosest);
    linear_tolerance = std::max(linear_tolerance, std::min(0.3 * p_.newton.tolerance / trial.relative, bounds.loosest));
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
    free.push_back(static_cast<Index>(v));
  }
  if (free.empty()) throw InvalidInput("constrained", "found no free vertex, expected at least one");
  order_compactly(body.rest_positions(), row_lanes, LaneSystem::part_rows, free);
  for (std::size_t row = 0; row < free.size(); ++row) rows[free[row]] = static_cast<Index>(row);
  const BlockMatrix constant = constant_part(body, dt, forces, rows);
  LocalRotations rotations(body.corners(), count, free);
  LaneSystem lanes(constant, body.corners().size());
  ElasticBody::Selection selection = body.select(lanes.part_tets());
  parts_ = std::make_unique<Parts>(Parts{body,
                                         std::move(material),
                                         dt,
                                         newton,
                                         forces,
                                         std::move(rows),
                                         std::move(free),
                                         std::move(lanes),
                                         std::move(selection),
                                         {},
                                         {},
                                         SparseCholesky(constant),
                                         {},
                                         {},
                                         Evaluation(count),
                                         std::move(rotations),
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
