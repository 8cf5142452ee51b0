// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The explicit baseline [DE, eq. 2 and A.3]: u(t+1) = u + v dt + a dt^2 / 2, v(t+1) = v + (a + a(t+1)) dt / 2, with the lumped
/// mass and, as it is only stable at small steps, several of them a frame. Too few, and it explodes.
#pragma once

#include <memory>

#include "followthrough/elastic/elastic_body.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

class CentralDifferences final : public Solver {
 public:
  /// Steps a frame beyond which none are added, however stiff the body.
  static constexpr int most_substeps = 10000;

  /// @param body copied
  /// @param material shared, never null
  /// @param constrained (n,) vertices that take the reference, in a straight line over a frame. Vertices without a tet do so too.
  /// @param dt s a frame, more than 0
  /// @param substeps steps a frame; 0: as many as are stable at the frame's start, with some to spare (see stable_step), and where
  /// the
  ///   frame turns out to need more, more
  /// @param gravity m/s2
  /// @param mass_damping Rayleigh's alpha, 1/s
  /// @throws InvalidInput on a wrong shape, negative or non-finite constants, or where no vertex is free
  CentralDifferences(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained, double dt,
                     int substeps = 0, const Eigen::Vector3d& gravity = Eigen::Vector3d::Zero(), double mass_damping = 0);

  Eigen::Index vertex_count() const override { return body_.vertex_count(); }
  void reset(ConstPositions reference) override;
  /// Positions that are not finite: the body has exploded.
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;
  /// Substeps of the last step.
  int last_substeps() const { return last_substeps_; }

  /// @return the longest stable step near these positions, s: 2 over the highest angular frequency
  double stable_step(ConstPositions positions) const;

  /// Arrays: positions, velocities, reference. Counters: frames since the reset.
  SolverState state() const override;
  void restore(const SolverState& state) override;

 private:
  Positions accelerations(const Positions& positions) const;
  /// Substeps that are stable at the present positions, with some to spare.
  int enough_substeps() const;
  /// A frame from the present state; `start` is the reference that it starts from.
  void advance(const Positions& start, int substeps);

  ElasticBody body_;
  std::shared_ptr<const Material> material_;
  double dt_;
  int substeps_;
  Eigen::Vector3d gravity_;
  double mass_damping_;
  Vector inverse_mass_;  // 0: follows the reference
  Positions positions_, velocities_, reference_;
  std::int64_t frames_ = -1;  // since the reset; -1: never reset
  int last_substeps_ = 0;
  int enough_ = 0;  // enough_substeps() at the present positions; 0: not known
};

}  // namespace followthrough
