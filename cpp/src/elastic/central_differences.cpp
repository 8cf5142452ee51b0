// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/central_differences.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

constexpr int power_iterations = 20;
// Share of the stable step that is taken, and less than which a frame may not end with: compression makes the material stiffer
// within a frame, and the power iteration comes from below.
constexpr double safety = 0.4;

void require_number(const char* name, double value, bool zero_allowed) {
  if (!(std::isfinite(value) && (value > 0 || (zero_allowed && value == 0)))) {
    throw InvalidInput(name, "found " + std::to_string(value) +
                                 (zero_allowed ? ", expected a finite number, 0 or more" : ", expected a finite number above 0"));
  }
}

}  // namespace

CentralDifferences::CentralDifferences(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained,
                                       double dt, int substeps, const Eigen::Vector3d& gravity, double mass_damping)
    : body_(body),
      material_(std::move(material)),
      dt_(dt),
      substeps_(substeps),
      gravity_(gravity),
      mass_damping_(mass_damping),
      inverse_mass_(Vector::Zero(body.vertex_count())) {
  require_rows("constrained", constrained.size(), vertex_count());
  require_number("dt", dt, false);
  require_number("mass_damping", mass_damping, true);
  require_finite("gravity", gravity.transpose());
  if (substeps < 0 || substeps > most_substeps) {
    throw InvalidInput("substeps", "found " + std::to_string(substeps) + ", expected 1 to " + std::to_string(most_substeps) +
                                       ", or 0 for as many as are stable");
  }
  for (Eigen::Index v = 0; v < vertex_count(); ++v) {
    if (!constrained[v] && body_.lumped_mass()[v] > 0) inverse_mass_[v] = 1 / body_.lumped_mass()[v];
  }
  if (inverse_mass_.maxCoeff() == 0) throw InvalidInput("constrained", "found no free vertex, expected at least one");
}

double CentralDifferences::stable_step(ConstPositions positions) const {
  require_rows("positions", positions.rows(), vertex_count());
  require_finite("positions", positions);
  // Neighbours move against each other in the fastest mode: so does the start.
  Positions mode(vertex_count(), 3);
  for (Eigen::Index k = 0; k < mode.size(); ++k) mode.data()[k] = std::sin(12.9898 * static_cast<double>(k + 1));
  double square = 0;
  for (int iteration = 0; iteration < power_iterations; ++iteration) {
    mode = ((inverse_mass_.array() > 0).cast<double>().matrix().asDiagonal() * mode).eval();
    mode /= mode.norm();
    mode = (inverse_mass_.asDiagonal() * body_.stiffness_product(positions, mode, *material_, Definiteness::kSemidefinite)).eval();
    square = mode.norm();
    if (!(square > 0)) break;
  }
  return square > 0 ? 2 / std::sqrt(square) : dt_;
}

Positions CentralDifferences::accelerations(const Positions& positions) const {
  Positions result = -(inverse_mass_.asDiagonal() * body_.internal_forces(positions, *material_));
  result.rowwise() += gravity_.transpose();
  return result;
}

void CentralDifferences::reset(ConstPositions reference) {
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  positions_ = reference;
  velocities_.setZero(vertex_count(), 3);
  reference_ = positions_;
  frames_ = 0;
  enough_ = 0;
}

const Positions& CentralDifferences::step(ConstPositions reference, const Positions*) {
  if (frames_ < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  ++frames_;
  const Positions start = reference_;
  reference_ = reference;
  if (!positions_.allFinite()) return positions_;
  if (substeps_ > 0) {
    advance(start, substeps_);
    return positions_;
  }
  // What is stable where the frame starts need not be where it leads: then it is taken again, in more substeps.
  const Positions first_positions = positions_, first_velocities = velocities_;
  int substeps = enough_ > 0 ? enough_ : enough_substeps();
  for (;;) {
    advance(start, substeps);
    enough_ = positions_.allFinite() ? enough_substeps() : most_substeps;
    if (safety * enough_ <= substeps || substeps == most_substeps) return positions_;
    // An exploded body asks for any number: nearer to the right one step by step.
    substeps = std::min(std::clamp(enough_, 2 * substeps, 4 * substeps), most_substeps);
    positions_ = first_positions;
    velocities_ = first_velocities;
  }
}

int CentralDifferences::enough_substeps() const {
  const double wanted = std::ceil(dt_ / (safety * stable_step(positions_)));
  return static_cast<int>(std::clamp(wanted, 1.0, static_cast<double>(most_substeps)));
}

void CentralDifferences::advance(const Positions& start, int substeps) {
  last_substeps_ = substeps;
  const double h = dt_ / substeps, kept = std::exp(-mass_damping_ * h);
  Positions acceleration = accelerations(positions_);
  for (int substep = 1; substep <= substeps; ++substep) {
    positions_ += h * velocities_ + 0.5 * h * h * acceleration;
    const double share = static_cast<double>(substep) / substeps;
    for (Eigen::Index v = 0; v < vertex_count(); ++v) {
      if (inverse_mass_[v] > 0) continue;
      if (substep == substeps) {
        positions_.row(v) = reference_.row(v);
      } else {
        positions_.row(v) = start.row(v) + share * (reference_.row(v) - start.row(v));
      }
    }
    if (!positions_.allFinite()) return;
    const Positions after = accelerations(positions_);
    velocities_ = kept * (velocities_ + 0.5 * h * (acceleration + after));
    acceleration = after;
  }
  if (!velocities_.allFinite()) positions_.setConstant(std::numeric_limits<double>::quiet_NaN());
}

SolverState CentralDifferences::state() const { return {{positions_, velocities_, reference_}, {frames_}}; }

void CentralDifferences::restore(const SolverState& state) {
  if (state.arrays.size() != 3 || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) +
                                    " counters, expected 3 and 1 as CentralDifferences.state gives them");
  }
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), state.counters[0] < 0 ? 0 : vertex_count());
    require_finite("state", array);
  }
  positions_ = state.arrays[0];
  velocities_ = state.arrays[1];
  reference_ = state.arrays[2];
  frames_ = state.counters[0];
  enough_ = 0;
}

}  // namespace followthrough
