// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A quick solver predicts each frame, and some iterations of the true one start from there: how much exactness a frame gets is a
/// dial. What comes out is the state of both, so errors of the predictor do not add up where the corrector has taken them away.
#pragma once

#include "followthrough/elastic/implicit_euler.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

class PredictorCorrector final : public Solver {
 public:
  /// @param predictor whose state holds two frames or more (Solver::frames_in_state); must outlive this
  /// @param corrector of as many vertices and the same time step, material and constraints; its settings say how many iterations a
  ///   frame gets. Must outlive this
  /// @throws InvalidInput where they do not fit each other
  PredictorCorrector(Solver& predictor, ImplicitEuler& corrector);

  Eigen::Index vertex_count() const override { return corrector_.vertex_count(); }
  void reset(ConstPositions reference) override;
  /// A prediction that is not finite is left to the corrector, which then starts from its own guess.
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;
  /// How the last correction went.
  const StepReport& last_step() const { return corrector_.last_step(); }

  /// Arrays: the predictor's, and the reference. Counters: the predictor's.
  SolverState state() const override;
  std::size_t frames_in_state() const override { return predictor_.frames_in_state(); }
  void restore(const SolverState& state) override;

 private:
  Solver& predictor_;
  ImplicitEuler& corrector_;
};

}  // namespace followthrough
