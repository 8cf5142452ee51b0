// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Damping for solvers that carry their motion as past positions (Solver::frames_in_state), a network among them, that has none of
/// its own: Rayleigh's mass-proportional damping, but of the motion relative to the reference, so that a character that runs or
/// falls is not held back by it.
///
/// After each step the displacement's velocity is multiplied by exp(-rate h), as exact damping for one frame would, whatever its
/// length h. A solver that knows velocities only as differences of positions gets them as a past that fits: with the displacement d
/// of the step from t to t+1, and w = (1 - exp(-rate h)) (d(t+1) - d(t)), the frames k before the newest are moved by k w. Second
/// differences, the accelerations, stay as they are.
#pragma once

#include "followthrough/solver.hpp"

namespace followthrough {

class RelativeDamping final : public Solver {
 public:
  /// @param solver whose state holds two frames or more; must outlive this
  /// @param rate 1/s, 0 or more; half of it is the rate at which slow swinging dies down. 2 w is critical for what swings at w
  /// radians a second
  /// @param dt s a frame, the solver's own
  /// @throws InvalidInput on other numbers, or another kind of solver
  RelativeDamping(Solver& solver, double rate, double dt);

  Eigen::Index vertex_count() const override { return solver_.vertex_count(); }
  void reset(ConstPositions reference) override;
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;
  /// @brief Damps the newest velocity, for frames that `restore` has brought in from elsewhere.
  /// @param reference, before (n,3) of the newest frame and the one before it, m
  void damp(ConstPositions reference, ConstPositions before);

  /// Arrays: the solver's, whose past is the damped one, and the reference.
  SolverState state() const override;
  std::size_t frames_in_state() const override { return solver_.frames_in_state(); }
  void restore(const SolverState& state) override;

 private:
  Solver& solver_;
  double lost_;  // share of a velocity in one frame
  Positions positions_, reference_;
};

}  // namespace followthrough
