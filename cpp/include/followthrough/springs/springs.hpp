// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dynamics by analytic zero-restlength springs ([ZS] sections 4 and 5): every vertex hangs on its own moving target by a damped
/// spring, and each frame is integrated in closed form, whatever its length and however stiff the spring.
///
/// The target passes through the references as a cubic (Hermite) with centred slopes, so a frame needs the reference of the frame
/// after it; where that is not known, and at the first frame, the slope is one-sided. The particle starts on its target and moves
/// with it. Positions and velocities are carried in the world, not relative to the target, so the motion stays smooth where a slope
/// that had to be one-sided is centred in the next frame.
#pragma once

#include "followthrough/solver.hpp"

namespace followthrough {

class Springs final : public Solver {
 public:
  /// @param stiffness (n,) ks: spring stiffness over mass, 1/s^2, 0 or more
  /// @param damping (n,) kd: damping over mass, 1/s, 0 or more; 2 sqrt(ks) is critical
  /// @param dt s a frame, more than 0
  /// @param pinned (n,) vertices that follow the reference exactly, or empty: none
  /// @param gravity m/s^2. A spring hangs by gravity / ks below its target: in between the same equation holds, so nothing else
  /// changes
  /// @throws InvalidInput on a wrong shape, on negative or non-finite constants, and where gravity acts on what no spring holds
  Springs(ConstVector stiffness, ConstVector damping, double dt, ConstMask pinned = Mask(),
          const Eigen::Vector3d& gravity = Eigen::Vector3d::Zero());

  Eigen::Index vertex_count() const override { return stiffness_.size(); }
  double dt() const { return dt_; }

  void reset(ConstPositions reference) override;
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  /// @brief Positions within the frame to come, on the same curve that step would take; changes nothing.
  /// @param fraction share of the frame, 0 to 1
  /// @param reference, next_reference as for step
  /// @return (n,3) positions, m
  /// @throws InvalidInput as step does, or where the fraction is outside 0 to 1
  Positions evaluate(double fraction, ConstPositions reference, const Positions* next_reference = nullptr) const;

  /// Arrays: positions, velocities, reference, reference before it. Counters: frames since the reset.
  SolverState state() const override;
  void restore(const SolverState& state) override;

 private:
  void require_references(ConstPositions reference, const Positions* next_reference) const;

  Vector stiffness_, damping_;
  double dt_;
  std::vector<Index> pinned_;  // ascending
  Values factors_;             // of one frame, in groups of vertices (SpringsFactor)
  Positions sag_;              // from the target to where the spring rests, m; no rows: nowhere any
  Positions positions_, velocities_, reference_, before_;
  std::int64_t frames_ = -1;  // since the reset; -1: never reset
};

}  // namespace followthrough
