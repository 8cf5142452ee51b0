// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Any solver on top of the quasistatic layer: it follows each pose's equilibrium where it would have followed the skinned
/// positions.
#pragma once

#include "followthrough/quasistatic/quasistatic.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

class OverQuasistatic final : public Solver {
 public:
  /// @param layer must outlive this, and is this one's alone
  /// @param solver of as many vertices; must outlive this. Null: none, the equilibria themselves are the dynamic positions.
  /// @throws InvalidInput where the numbers of vertices differ
  explicit OverQuasistatic(Quasistatic& layer, Solver* solver = nullptr);

  Eigen::Index vertex_count() const override { return layer_.vertex_count(); }
  void reset(ConstPositions reference) override;
  /// The next reference's equilibrium is found ahead and not again when it becomes the reference.
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;
  /// How the search for the last frame's equilibrium went.
  const StepReport& last_solve() const { return report_; }

  /// Arrays: the solver's (without one, none), the equilibrium of the last frame, the one that was found last, and its reference.
  /// Counters: frames since the reset.
  SolverState state() const override;
  void restore(const SolverState& state) override;

 private:
  void find(ConstPositions reference);

  Quasistatic& layer_;
  Solver* solver_;
  Positions equilibrium_;  // of the last frame
  StepReport report_, report_ahead_;
  std::int64_t frames_ = -1;  // since the reset; -1: never reset
};

}  // namespace followthrough
