// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The static equilibrium of an elastic body for one pose [ZS 3.1]: constrained vertices take the reference, soft pins pull
/// towards it, and the free vertices rest where elastic forces, pins and gravity cancel. No solver: it has no time and no velocity.
#pragma once

#include <memory>

#include "followthrough/elastic/elastic_body.hpp"
#include "followthrough/elastic/implicit_euler.hpp"

namespace followthrough {

/// How far each equilibrium is sought. Every limit bounds a pose's work; the tolerance ends it sooner.
struct EquilibriumSettings {
  /// Size of what is left of the forces on free vertices, relative to what holds the body (constrained vertices, pins, gravity).
  double tolerance = 1e-9;
  int most_iterations = 300;
  /// Iterations of conjugate gradients within one of Newton's.
  int most_linear_iterations = 3000;

  static EquilibriumSettings converged() { return {}; }
  static EquilibriumSettings fine() { return {1e-3, 60, 1000}; }
  static EquilibriumSettings preview() { return {1e-2, 6, 100}; }
};

/// Forces besides elasticity; all off as they come.
struct StaticForces {
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< m/s2
  Vector pin_stiffness;                               ///< (n,) N/m of springs to the reference; empty: none
};

/// Newton's method with conjugate gradients. It goes downhill in the total energy (elastic, pins, gravity), with the part of each
/// tet's stiffness that may not be positive semidefinite left out until the end is near, so it finds a minimum and no saddle. Where
/// tets are beyond a material's clamp (InvertibleStVK) their forces have no energy; what counts there is the forces' own work.
class Quasistatic {
 public:
  /// @param body copied
  /// @param material shared, never null
  /// @param constrained (n,) vertices that take the reference exactly. Vertices without a tet do so too.
  /// @throws InvalidInput on a wrong shape, negative or non-finite constants, where no vertex is free, or where gravity acts on a
  ///   part of the body that nothing holds
  Quasistatic(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained,
              const EquilibriumSettings& settings = {}, const StaticForces& forces = {});
  ~Quasistatic();
  Quasistatic(Quasistatic&&) noexcept;
  Quasistatic& operator=(Quasistatic&&) noexcept;

  Eigen::Index vertex_count() const;

  /// @brief The equilibrium for a pose.
  ///
  /// The search starts from the reference or from the last equilibrium, moved as the reference has moved since, whichever has the
  /// lower energy. So poses along an animation are quick; where the equilibrium is unique it does not depend on the start. A part
  /// of the body that nothing holds starts from the reference always.
  /// @param reference (n,3) m
  /// @return (n,3) m, valid until the next call. An equilibrium that was not reached is reported, not refused: these are then the
  ///   best positions found, finite ones always.
  /// @throws InvalidInput on a wrong shape or non-finite numbers
  const Positions& solve(ConstPositions reference);
  const StepReport& last_solve() const;

  /// (n,3) of the last call, m; no rows before the first one.
  const Positions& last_reference() const;
  const Positions& last_equilibrium() const;
  /// @brief Has the next search start as if these had come out of the last one.
  /// @param equilibrium, reference (n,3) m, or no rows
  /// @throws InvalidInput on a wrong shape or non-finite numbers
  void start_from(ConstPositions equilibrium, ConstPositions reference);
  /// Has the next search start from its reference.
  void forget();

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
