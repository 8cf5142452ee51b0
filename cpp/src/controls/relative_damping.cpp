// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/controls/relative_damping.hpp"

#include <cmath>
#include <string>

#include "followthrough/errors.hpp"

namespace followthrough {

RelativeDamping::RelativeDamping(Solver& solver, double rate, double dt) : solver_(solver), lost_(-std::expm1(-rate * dt)) {
  if (!(std::isfinite(rate) && rate >= 0.0)) {
    throw InvalidInput("rate", "found " + std::to_string(rate) + ", expected a finite number, 0 or more");
  }
  if (!(std::isfinite(dt) && dt > 0.0)) {
    throw InvalidInput("dt", "found " + std::to_string(dt) + ", expected a positive number of seconds");
  }
  if (solver.frames_in_state() < 2) {
    throw InvalidInput("solver", "found one whose state is not its last frames, expected one such as Emulator");
  }
}

void RelativeDamping::damp(ConstPositions reference, ConstPositions before) {
  SolverState state = solver_.state();
  if (!state.arrays.front().allFinite()) return;  // the caller will see
  const Positions lost = lost_ * ((state.arrays[0] - reference) - (state.arrays[1] - before));
  for (std::size_t k = 1; k < solver_.frames_in_state(); ++k) state.arrays[k] += static_cast<double>(k) * lost;
  solver_.restore(state);
}

void RelativeDamping::reset(ConstPositions reference) {
  solver_.reset(reference);
  reference_ = reference;
}

const Positions& RelativeDamping::step(ConstPositions reference, const Positions* next_reference) {
  positions_ = solver_.step(reference, next_reference);
  damp(reference, reference_);
  reference_ = reference;
  return positions_;
}

SolverState RelativeDamping::state() const {
  SolverState state = solver_.state();
  state.arrays.push_back(reference_);
  return state;
}

void RelativeDamping::restore(const SolverState& state) {
  if (state.arrays.size() < 3) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) +
                                    " arrays, expected the solver's and one more as RelativeDamping.state gives them");
  }
  require_rows("state", state.arrays.back().rows(), state.arrays.front().rows());
  require_finite("state", state.arrays.back());
  solver_.restore({{state.arrays.begin(), state.arrays.end() - 1}, state.counters});
  reference_ = state.arrays.back();
}

}  // namespace followthrough
