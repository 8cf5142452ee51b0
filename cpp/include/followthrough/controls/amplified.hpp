// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// How far secondary motion goes, on any solver: its displacement from the reference, times a number.
///
/// The motion itself stays as it was simulated, so its timing does not change with the amplitude: 0 is the reference to the bit, 1
/// the solver, and between and beyond it is linear. For springs this is the same as scaling the accelerations that they feel, since
/// they are linear in them. For elastic flesh it is not: flesh that felt no acceleration would still sag out of a pose that
/// squeezes it.
#pragma once

#include "followthrough/solver.hpp"

namespace followthrough {

class Amplified final : public Solver {
 public:
  /// @param solver must outlive this
  /// @param amplitude 0 or more
  /// @throws InvalidInput on another amplitude
  Amplified(Solver& solver, double amplitude);

  Eigen::Index vertex_count() const override { return solver_.vertex_count(); }
  void reset(ConstPositions reference) override { solver_.reset(reference); }
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  /// The solver's.
  SolverState state() const override { return solver_.state(); }
  void restore(const SolverState& state) override { solver_.restore(state); }

 private:
  Solver& solver_;
  double amplitude_;
  Positions positions_;
};

}  // namespace followthrough
