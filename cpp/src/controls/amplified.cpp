// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/controls/amplified.hpp"

#include <cmath>
#include <string>

#include "followthrough/errors.hpp"

namespace followthrough {

Amplified::Amplified(Solver& solver, double amplitude) : solver_(solver), amplitude_(amplitude) {
  if (!(std::isfinite(amplitude) && amplitude >= 0.0)) {
    throw InvalidInput("amplitude", "found " + std::to_string(amplitude) + ", expected a finite number, 0 or more");
  }
}

const Positions& Amplified::step(ConstPositions reference, const Positions* next_reference) {
  const Positions& dynamic = solver_.step(reference, next_reference);
  positions_ = dynamic;
  if (amplitude_ == 0.0) {
    positions_ = reference;
  } else if (amplitude_ != 1.0) {
    positions_ = reference + amplitude_ * (dynamic - reference);
  }
  return positions_;
}

}  // namespace followthrough
