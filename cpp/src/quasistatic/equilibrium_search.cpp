// SPDX-License-Identifier: GPL-3.0-or-later
#include "quasistatic/equilibrium_search.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <utility>

#include "elastic/descent.hpp"

namespace followthrough {
namespace {

// Forces below what moving every vertex by this share of an edge would cause count as none: at rest they are round-off.
constexpr double smallest_move = 1e-11;
// Armijo's constant: share of the predicted decrease that a step must bring.
constexpr double sufficient_decrease = 1e-4;
constexpr int most_halvings = 20;
// Share of a vertex's stiffness at rest that is added where tets offer none.
constexpr double least_stiffness = 1e-8;
// Relative residual below which the exact stiffness is tried: the convex one is too stiff to converge fast.
constexpr double near_the_end = 0.1;
// How far vertices are shaken, in edges, where the search is stuck farther from the end than `stuck_at_the_end`; and how often.
constexpr double shake = 0.1;
constexpr double stuck_at_the_end = 1e-6;
constexpr int most_shakes = 3;

class Search {
 public:
  Search(EquilibriumProblem& problem, ConstPositions reference, StepReport& report)
      : p_(problem), reference_(reference), report_(report) {}

  Positions run(const Positions* carried);

 private:
  Trial evaluate(Positions positions) const;
  Trial start(const Positions* carried) const;
  bool within_tolerance(const Trial& trial) const { return trial.relative <= p_.settings.tolerance; }
  bool step(Trial& trial, double linear_tolerance);
  bool step(Trial& trial, double linear_tolerance, Definiteness definiteness);
  bool advance(Trial& trial, const Vector& direction) const;
  Trial shaken(const Trial& trial, int time) const;

  EquilibriumProblem& p_;
  ConstPositions reference_;
  StepReport& report_;
};

Trial Search::evaluate(Positions positions) const {
  Trial trial;
  const Positions elastic = p_.body.internal_forces(positions, *p_.material, &trial.energy);
  trial.residual.resize(3 * p_.rest_stiffness.size());
  double holding = 0, left = 0, stiffness = 0, farthest = 0;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) {
    const Eigen::Index row = p_.rows[v];
    if (row < 0) {
      holding += elastic.row(v).squaredNorm();
      continue;
    }
    const Eigen::RowVector3d lag = positions.row(v) - reference_.row(v);
    const Eigen::RowVector3d weight = p_.body.lumped_mass()[v] * p_.forces.gravity.transpose();
    const Eigen::RowVector3d pull = p_.forces.pin_stiffness[v] * lag;
    const Eigen::RowVector3d force = elastic.row(v) + pull - weight;
    trial.energy += (0.5 * pull - weight).dot(lag);
    holding += pull.squaredNorm() + weight.squaredNorm();
    trial.residual.segment<3>(3 * row) = force.transpose();
    trial.size += force.squaredNorm() / p_.rest_stiffness[row];
    left += force.squaredNorm();
    stiffness += p_.rest_stiffness[row] * p_.rest_stiffness[row];
    farthest = std::max(farthest, positions.row(v).cwiseAbs().maxCoeff());
  }
  trial.size = std::sqrt(trial.size);
  // Converged are forces below tolerance * holding, or such that are round-off.
  const double move = smallest_move * p_.body.edge_length() + 4 * std::numeric_limits<double>::epsilon() * farthest;
  trial.relative = std::sqrt(left) / std::max(std::sqrt(holding), std::sqrt(stiffness) * move / p_.settings.tolerance);
  trial.positions = std::move(positions);
  return trial;
}

Trial Search::start(const Positions* carried) const {
  Trial best = evaluate(reference_);
  if (!carried) return best;
  Positions positions = reference_;
  for (const Index v : p_.free) positions.row(v) = carried->row(v);
  Trial trial = evaluate(std::move(positions));
  const bool better = trial.finite() && !(best.energy <= trial.energy);
  return better ? trial : best;
}

// Takes as much of a direction as helps; false where nothing does. The merit is the total energy. Beyond a material's clamp the
// forces are those of no energy, and the one that is reported would refuse good steps. There a step is good that shrinks the
// residual and is downhill by the work of the forces along it, which is the decrease of the energy to third order where there is
// one.
bool Search::advance(Trial& trial, const Vector& direction) const {
  const double slope = trial.residual.dot(direction);
  if (!(slope < 0)) return false;
  return search_along(
      trial, direction, p_.free, most_halvings, [&](Positions positions) { return evaluate(std::move(positions)); },
      [&](const Trial& next, double share) {
        const double decrease = sufficient_decrease * share * slope;
        const double work = 0.5 * share * (slope + next.residual.dot(direction));
        return next.energy <= trial.energy + decrease ||
               (work <= decrease && next.size <= (1 - 0.1 * std::min(share, 1.0)) * trial.size);
      });
}

// One iteration of Newton's method; false where it leads nowhere.
bool Search::step(Trial& trial, double linear_tolerance, Definiteness definiteness) {
  p_.matrix.copy_values(p_.pins);
  p_.body.add_stiffness(trial.positions, *p_.material, definiteness, 1, p_.matrix);
  if (definiteness == Definiteness::kConvex) {
    for (Eigen::Index row = 0; row < p_.rest_stiffness.size(); ++row) {
      p_.matrix.add_to_diagonal(row, least_stiffness * p_.rest_stiffness[row] * BlockMatrix::Block::Identity());
    }
  }
  const bool factored = p_.factor.compute(p_.matrix);
  if (!factored) {
    if (definiteness == Definiteness::kSymmetric) return false;
    p_.diagonal.compute(p_.matrix);
  }
  const Preconditioner& preconditioner = factored ? static_cast<const Preconditioner&>(p_.factor) : p_.diagonal;
  Vector direction;
  const LinearReport linear =
      solve(p_.matrix, preconditioner, -trial.residual, linear_tolerance, p_.settings.most_linear_iterations, direction);
  report_.linear_iterations += linear.iterations;
  // An indefinite stiffness leads to saddles. What rounding makes of a semidefinite one does not: its iterate is still downhill.
  if (linear.negative_curvature && definiteness != Definiteness::kConvex) return false;
  return advance(trial, direction);
}

bool Search::step(Trial& trial, double linear_tolerance) {
  if (trial.relative < near_the_end && step(trial, linear_tolerance, Definiteness::kSymmetric)) return true;
  return step(trial, linear_tolerance, Definiteness::kConvex);
}

// Away from where forces cancel by symmetry and lead nowhere, as in a body that a pose has turned inside out.
Trial Search::shaken(const Trial& trial, int time) const {
  Positions positions = trial.positions;
  std::minstd_rand random(static_cast<unsigned>(time));
  for (const Index v : p_.free) {
    for (int axis = 0; axis < 3; ++axis) {
      const double share = static_cast<double>(random()) / static_cast<double>(std::minstd_rand::max());
      positions(v, axis) += shake * p_.body.edge_length() * (share - 0.5);
    }
  }
  return evaluate(std::move(positions));
}

Positions Search::run(const Positions* carried) {
  Trial trial = start(carried), best = trial;
  double linear_tolerance = 0.1;
  int shakes = 0;
  report_ = {};
  while (!within_tolerance(trial) && report_.iterations < p_.settings.most_iterations) {
    ++report_.iterations;
    const double before = trial.size;
    if (step(trial, linear_tolerance)) {
      // As exact as Newton's method will converge, but no better than the pose needs.
      const double gain = trial.size / before;
      linear_tolerance = std::clamp(0.5 * gain * gain, 1e-6, 0.1);
      linear_tolerance = std::max(linear_tolerance, std::min(0.3 * p_.settings.tolerance / trial.relative, 0.1));
      continue;
    }
    if (trial.relative < best.relative) best = trial;
    if (trial.relative < stuck_at_the_end || shakes == most_shakes) break;
    trial = shaken(trial, ++shakes);
    linear_tolerance = 0.1;
  }
  if (!(trial.relative <= best.relative)) trial = std::move(best);
  report_.residual = trial.relative;
  report_.converged = within_tolerance(trial);
  return std::move(trial.positions);
}

}  // namespace

Positions find_equilibrium(EquilibriumProblem& problem, ConstPositions reference, const Positions* carried, StepReport& report) {
  return Search(problem, reference, report).run(carried);
}

}  // namespace followthrough
