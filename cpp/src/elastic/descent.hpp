// SPDX-License-Identifier: GPL-3.0-or-later
// What Newton's methods for a step and for an equilibrium share: positions that are tried, and the search along a direction.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// Positions that a search tries, with all that is known there.
struct Trial {
  Positions positions;
  double energy = 0;
  Vector residual;      ///< its gradient at the free vertices, 3 numbers each
  double size = 0;      ///< of the residual, in a norm that weighs vertices
  double relative = 0;  ///< of the residual, against what it is made of

  bool finite() const { return std::isfinite(energy) && std::isfinite(size) && std::isfinite(relative); }
};

/// Positions moved by a share of a direction, which has 3 numbers a free vertex.
inline Positions moved(const Trial& trial, const Vector& direction, double share, const std::vector<Index>& free) {
  Positions positions = trial.positions;
  for (std::size_t row = 0; row < free.size(); ++row) {
    positions.row(free[row]) += share * direction.segment<3>(3 * static_cast<Eigen::Index>(row)).transpose();
  }
  return positions;
}

/// @brief Where the cubic through the energies and slopes at 0 and 1 is least.
/// @return NaN where it is nowhere
inline double cubic_minimum(double energy_0, double slope_0, double energy_1, double slope_1) {
  const double bend = slope_0 + slope_1 - 3 * (energy_1 - energy_0);
  const double root = std::sqrt(bend * bend - slope_0 * slope_1);
  return 1 - (slope_1 + root - bend) / (slope_1 - slope_0 + 2 * root);
}

/// @brief Takes as much of a direction as helps: all of it, more where the energy is still falling there, or a half, a quarter...
///
/// Compression resistance grows with the square of the squeeze. Where it outweighs everything else, the energy along a direction is
/// a cubic, whose minimum is twice as far as Newton's method thinks.
/// @param evaluate positions -> Trial
/// @param good (Trial, share) -> whether it is good enough, finite ones only
/// @return false where nothing helps; the trial is then as it was
template <typename Evaluate, typename Good>
bool search_along(Trial& trial, const Vector& direction, const std::vector<Index>& free, int most_halvings,
                  const Evaluate& evaluate, const Good& good) {
  constexpr double still_falling = 0.1;  // share of the slope at the start
  constexpr double least_share = 1.2, greatest_share = 3;
  double share = 1;
  for (int halving = 0; halving <= most_halvings; ++halving, share /= 2) {
    Trial next = evaluate(moved(trial, direction, share, free));
    if (!next.finite() || !good(next, share)) continue;
    const double slope = trial.residual.dot(direction), slope_there = next.residual.dot(direction);
    if (halving == 0 && next.energy < trial.energy && slope_there < still_falling * slope) {
      const double farther = cubic_minimum(trial.energy, slope, next.energy, slope_there);
      if (farther > 1) {
        const double share_there = std::clamp(farther, least_share, greatest_share);
        Trial there = evaluate(moved(trial, direction, share_there, free));
        if (there.finite() && there.energy < next.energy && good(there, share_there)) next = std::move(there);
      }
    }
    trial = std::move(next);
    return true;
  }
  return false;
}

}  // namespace followthrough
