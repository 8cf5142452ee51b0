// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Soft pins for solvers that carry their motion as past positions (Solver::frames_in_state) and have no springs of their own to
/// hang on: after each step a vertex is drawn towards its reference.
///
/// A backward Euler step with a spring of stiffness p more satisfies (A + h^2 p) d = A d*, with the step's system matrix A = m +
/// h^2 k and the displacement d* that the step without it had. With A's diagonal alone, as in one Jacobi iteration, d = d* / (1 +
/// (h^2 p / m) / (1 + h^2 k / m)), which is exact for what swings as one piece (a layer of flesh on a bone); what a pin leaves does
/// then not depend on the frame length.
#pragma once

#include "followthrough/solver.hpp"

namespace followthrough {

class SoftPins final : public Solver {
 public:
  /// @param solver whose state holds two frames or more; must outlive this
  /// @param share (n,) of its displacement that a vertex keeps in each step, 0 to 1; 1: free
  /// @throws InvalidInput on a wrong shape, other numbers, or another kind of solver
  SoftPins(Solver& solver, Vector share);

  Eigen::Index vertex_count() const override { return solver_.vertex_count(); }
  void reset(ConstPositions reference) override { solver_.reset(reference); }
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  /// The solver's.
  SolverState state() const override { return solver_.state(); }
  std::size_t frames_in_state() const override { return solver_.frames_in_state(); }
  void restore(const SolverState& state) override { solver_.restore(state); }

 private:
  Solver& solver_;
  Vector share_;
  Positions positions_;
};

}  // namespace followthrough
