// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/step_guard.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "elastic/descent.hpp"

namespace followthrough {
namespace {

// Share of the predicted decrease of the energy that a step along the direction must bring (Armijo), and the energy's round-off: of
// what is hardly strained, whose residual tells more, and of all else.
constexpr double sufficient_decrease = 1e-4, rounding_near = 1e-4, rounding_far = 1e-6;
// How much a guide's step may raise the energy, over its slope along the direction and over the energy. Guides reach farther than
// truncated conjugate gradients do, and leave ripples that the next pass smooths, where there is one.
constexpr double tolerated_rise = 1.0, greatest_rise = 0.25;
// How often a pass's step is taken again, shorter.
constexpr int most_retries = 6;
// Bounds of how much shorter.
constexpr double least_shortening = 0.1, greatest_shortening = 0.5;
// Share of the slope that makes it worth while to go farther, and how much farther.
constexpr double still_falling = 0.1, least_lengthening = 1.2, greatest_lengthening = 3.0;

// Share of the residual that a step leaves where passes are slow; the most that is believed, as a step may also raise it.
constexpr double slow_rate = 0.5, greatest_rate = 0.9;
// The least that a step is trusted to leave before it has been looked at.
constexpr double least_rate = 0.1;

bool none(const std::vector<bool>& flags) { return std::find(flags.begin(), flags.end(), true) == flags.end(); }

}  // namespace

bool StepGuard::TakenStep::good(double energy_there, double left_there) const {
  const double rounding = left_there < left ? rounding_near : rounding_far;
  double change = sufficient_decrease * share * slope;
  if (share == 0.0 && !last) change = std::min(-tolerated_rise * slope, greatest_rise * energy);
  return energy_there <= energy + change + rounding * std::abs(energy);
}

double StepGuard::TakenStep::shorter_share(double energy_there) const {
  const double least = -0.5 * slope * share * share / (energy_there - energy - slope * share);
  if (!std::isfinite(least)) return least_shortening * share;
  return std::clamp(least, least_shortening * share, greatest_shortening * share);
}

void StepGuard::before_step(bool guided, bool last) {
  problem_.save();
  taken_ = TakenStep{problem_.energy, left_, problem_.slope, guided ? 0.0 : 1.0, last};
}

// The step that has been taken, as a share of its direction instead.
double StepGuard::retake(double share) {
  taken_->share = share;
  problem_.go_back_and_move(share);
  return problem_.assemble(tangent_);
}

// The whole direction has been taken: takes more of it where the energy is still falling there.
double StepGuard::lengthen(double left) {
  const double energy = problem_.energy, slope = problem_.slope_along_saved();
  if (!(slope < still_falling * taken_->slope)) return left;
  const double farther = cubic_minimum(taken_->energy, taken_->slope, energy, slope);
  if (!(farther > 1.0)) return left;
  left = retake(std::clamp(farther, least_lengthening, greatest_lengthening));
  return problem_.energy < energy ? left : retake(1.0);
}

double StepGuard::expected_error(double reach) const {
  return rate_ > 0.0 ? left_ * std::max(reach, 1.0) / (1.0 - std::min(rate_, greatest_rate)) : left_;
}

bool StepGuard::ends_frame(double reach, double enough) const {
  if (eager_ || !directions_exact_ || steps_ == 0 || !(rate_ <= slow_rate)) return false;
  if (!(std::max(rate_, least_rate) * expected_error(reach) < enough)) return false;
  return none(better_off_at_reference(problem_.island_energies()));
}

double StepGuard::evaluate(Tangent tangent) {
  tangent_ = tangent;
  if (!taken_) return left_ = problem_.assemble(tangent_);
  const double before = taken_->left;
  left_ = evaluate_step();
  rate_ = before > 0.0 ? left_ / before : 0.0;
  slow_ = slow_ || rate_ > slow_rate;
  guided_ = guided_ && (steps_ == 0 || rate_ <= slow_rate);
  ++steps_;
  return left_;
}

double StepGuard::evaluate_step() {
  left_ = problem_.assemble(tangent_);
  int retries = 0;
  for (; !taken_->good(problem_.energy, left_); ++retries) {
    if (retries == most_retries) {
      problem_.go_back_and_move(0.0);
      taken_.reset();
      problem_.assemble(tangent_);
      return 0.0;
    }
    left_ = retake(taken_->share > 0.0 ? taken_->shorter_share(problem_.energy) : 1.0);
  }
  if ((retries > 0 || eager_) && taken_->share == 1.0) left_ = lengthen(left_);
  taken_.reset();
  return left_;
}

// Islands that may have less energy at the reference than these: inertia alone has.
std::vector<bool> StepGuard::better_off_at_reference(const std::vector<double>& energies) const {
  const std::vector<double> inertia = problem_.island_inertia_at_reference();
  std::vector<bool> goes(energies.size());
  for (std::size_t k = 0; k < goes.size(); ++k) goes[k] = inertia[k] < energies[k];
  return goes;
}

bool StepGuard::go_to_better_reference() {
  const double energy = problem_.energy;
  const std::vector<double> before = problem_.island_energies();
  std::vector<bool> goes = better_off_at_reference(before);
  const auto go = [&] {
    problem_.go_to_reference(goes);
    problem_.assemble(Tangent::convex);
  };
  if (none(goes)) return false;
  problem_.save();
  go();
  const std::vector<double> there = problem_.island_energies();
  bool all_gain = true;
  for (std::size_t k = 0; k < goes.size(); ++k) {
    const bool gains = there[k] < before[k];
    all_gain = all_gain && (gains || !goes[k]);
    goes[k] = goes[k] && gains;
  }
  if (!all_gain) {
    problem_.go_back_and_move(0.0);
    if (none(goes)) return false;
    go();
  }
  if (problem_.energy < energy) return true;
  problem_.go_back_and_move(0.0);
  return false;
}

}  // namespace followthrough
