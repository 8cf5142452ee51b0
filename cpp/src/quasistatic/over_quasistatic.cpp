// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/quasistatic/over_quasistatic.hpp"

#include <string>
#include <utility>

#include "followthrough/errors.hpp"

namespace followthrough {

OverQuasistatic::OverQuasistatic(Quasistatic& layer, Solver* solver) : layer_(layer), solver_(solver) {
  if (solver_) require_rows("solver", solver_->vertex_count(), layer_.vertex_count());
}

// Makes `equilibrium_` that of a reference, which may have been found ahead.
void OverQuasistatic::find(ConstPositions reference) {
  if (layer_.last_reference().rows() == reference.rows() && layer_.last_reference() == reference) {
    equilibrium_ = layer_.last_equilibrium();
    report_ = report_ahead_;
    return;
  }
  equilibrium_ = layer_.solve(reference);
  report_ = report_ahead_ = layer_.last_solve();
}

void OverQuasistatic::reset(ConstPositions reference) {
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  layer_.forget();
  find(reference);
  if (solver_) solver_->reset(equilibrium_);
  frames_ = 0;
}

const Positions& OverQuasistatic::step(ConstPositions reference, const Positions* next_reference) {
  if (frames_ < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  if (next_reference) {
    require_rows("next_reference", next_reference->rows(), vertex_count());
    require_finite("next_reference", *next_reference);
  }
  find(reference);
  ++frames_;
  if (!solver_) return equilibrium_;
  if (!next_reference) return solver_->step(equilibrium_);
  const Positions ahead = layer_.solve(*next_reference);
  report_ahead_ = layer_.last_solve();
  return solver_->step(equilibrium_, &ahead);
}

SolverState OverQuasistatic::state() const {
  SolverState state;
  if (solver_) state = solver_->state();
  state.counters = {frames_};
  state.arrays.insert(state.arrays.end(), {equilibrium_, layer_.last_equilibrium(), layer_.last_reference()});
  return state;
}

void OverQuasistatic::restore(const SolverState& state) {
  const std::size_t count = state.arrays.size();
  if (count < 3 || (count > 3) != (solver_ != nullptr) || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(count) + " arrays and " + std::to_string(state.counters.size()) +
                                    " counters, expected as many as OverQuasistatic.state gives");
  }
  for (std::size_t k = count - 3; k < count; ++k) {
    require_rows("state", state.arrays[k].rows(), state.counters[0] < 0 ? 0 : vertex_count());
    require_finite("state", state.arrays[k]);
  }
  if (solver_) solver_->restore({{state.arrays.begin(), state.arrays.end() - 3}, state.counters});
  layer_.start_from(state.arrays[count - 2], state.arrays[count - 1]);
  equilibrium_ = state.arrays[count - 3];
  report_ = report_ahead_ = {};
  frames_ = state.counters[0];
}

}  // namespace followthrough
