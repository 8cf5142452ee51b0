// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/controls/soft_pins.hpp"

#include <string>
#include <utility>

#include "followthrough/errors.hpp"

namespace followthrough {

SoftPins::SoftPins(Solver& solver, Vector share) : solver_(solver), share_(std::move(share)) {
  require_rows("share", share_.size(), solver.vertex_count());
  for (Eigen::Index v = 0; v < share_.size(); ++v) {
    if (!(share_[v] >= 0.0 && share_[v] <= 1.0)) {
      throw InvalidInput("share", "found " + std::to_string(share_[v]) + " at vertex " + std::to_string(v) + ", expected 0 to 1");
    }
  }
  if (solver.frames_in_state() < 2) {
    throw InvalidInput("solver", "found one whose state is not its last frames, expected one such as Emulator");
  }
}

const Positions& SoftPins::step(ConstPositions reference, const Positions* next_reference) {
  solver_.step(reference, next_reference);
  SolverState state = solver_.state();
  positions_ = state.arrays.front();
  if (!positions_.allFinite()) return positions_;  // the caller will see
  for (Eigen::Index v = 0; v < share_.size(); ++v) {
    if (share_[v] != 1.0) positions_.row(v) = reference.row(v) + share_[v] * (positions_.row(v) - reference.row(v));
  }
  state.arrays.front() = positions_;
  solver_.restore(state);
  return positions_;
}

}  // namespace followthrough
