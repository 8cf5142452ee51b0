// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The ground truth: finite elements, one backward Euler step a frame, solved by Newton's method. Constrained vertices take the
/// reference exactly; the free ones satisfy M (u(t+1) - 2 u(t) + u(t-1)) + dt^2 f(u(t+1)) = 0, with the consistent mass matrix also
/// between free and constrained vertices. Before the first frame, the history repeats it.
#pragma once

#include <memory>

#include "followthrough/elastic/elastic_body.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

/// How far each step is taken. Every limit bounds a frame's work; the tolerance ends it sooner.
struct NewtonSettings {
  /// Size of the residual, relative to its inertial and its elastic part, at which a step has converged.
  double tolerance = 1e-9;
  int most_iterations = 100;
  /// Iterations of conjugate gradients within one of Newton's.
  int most_linear_iterations = 2000;

  /// What each costs and how far it is from converged: docs/performance.md.
  static NewtonSettings converged() { return {}; }
  static NewtonSettings fine() { return {1e-2, 30, 500}; }
  static NewtonSettings preview() { return {5e-2, 6, 60}; }
};

/// Forces besides elasticity; all off as they come.
struct ExternalForces {
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< m/s2
  double mass_damping = 0;                            ///< Rayleigh's alpha, 1/s
  double stiffness_damping = 0;                       ///< Rayleigh's beta, s: times the stiffness at the frame's start
  Vector pin_stiffness;                               ///< (n,) N/m of springs to the reference; empty: none
};

/// What became of a step.
struct StepReport {
  bool converged = true;      ///< the residual is within the tolerance
  int iterations = 0;         ///< of Newton's method
  int linear_iterations = 0;  ///< of conjugate gradients, all in all
  double residual = 0;        ///< relative, at the end
};

class ImplicitEuler final : public Solver {
 public:
  /// @param body copied
  /// @param material shared, never null
  /// @param constrained (n,) vertices that take the reference exactly. Vertices without a tet do so too.
  /// @param dt s a frame, more than 0
  /// @throws InvalidInput on a wrong shape, negative or non-finite constants, or where no vertex is free
  ImplicitEuler(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained, double dt,
                const NewtonSettings& newton = {}, const ExternalForces& forces = {});
  ~ImplicitEuler() override;

  Eigen::Index vertex_count() const override;
  void reset(ConstPositions reference) override;
  /// A step that does not converge is reported, not refused: it keeps the best positions it has found, finite ones always.
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;
  /// @brief The same step, for which somebody else has an idea where it leads.
  /// @param prediction (n,3) where Newton's method starts, m, unless its own guess has the lower incremental potential (which a
  ///   prediction that is not finite never has)
  /// @param reference as for step
  /// @throws InvalidInput as step does
  const Positions& step_from(ConstPositions prediction, ConstPositions reference);
  const StepReport& last_step() const;

  /// Arrays: positions, positions before them, reference. Counters: frames since the reset.
  SolverState state() const override;
  std::size_t frames_in_state() const override { return 2; }
  void restore(const SolverState& state) override;

 private:
  class Step;
  struct Parts;
  const Positions& take_step(ConstPositions reference, const ConstPositions* prediction);
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
