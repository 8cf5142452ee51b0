// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/predictor_corrector.hpp"

#include <string>

#include "followthrough/errors.hpp"

namespace followthrough {

PredictorCorrector::PredictorCorrector(Solver& predictor, ImplicitEuler& corrector) : predictor_(predictor), corrector_(corrector) {
  require_rows("predictor", predictor.vertex_count(), corrector.vertex_count());
  if (predictor.frames_in_state() < 2) {
    throw InvalidInput("predictor", "found a solver whose state is not its last frames, expected one such as Emulator");
  }
}

void PredictorCorrector::reset(ConstPositions reference) {
  corrector_.reset(reference);
  predictor_.reset(reference);
}

const Positions& PredictorCorrector::step(ConstPositions reference, const Positions* next_reference) {
  const Positions prediction = predictor_.step(reference, next_reference);
  const Positions& corrected = corrector_.step_from(prediction, reference);
  SolverState state = predictor_.state();
  state.arrays.front() = corrected;
  predictor_.restore(state);
  return corrected;
}

SolverState PredictorCorrector::state() const {
  SolverState state = predictor_.state();
  state.arrays.push_back(corrector_.state().arrays.back());
  return state;
}

void PredictorCorrector::restore(const SolverState& state) {
  if (state.arrays.size() < 3) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) +
                                    " arrays, expected the predictor's and one more as PredictorCorrector.state gives them");
  }
  const SolverState before = predictor_.state();
  predictor_.restore({{state.arrays.begin(), state.arrays.end() - 1}, state.counters});
  try {
    corrector_.restore({{state.arrays[0], state.arrays[1], state.arrays.back()}, {state.counters.front()}});
  } catch (...) {
    predictor_.restore(before);
    throw;
  }
}

}  // namespace followthrough
