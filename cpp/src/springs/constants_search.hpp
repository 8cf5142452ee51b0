// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The search for one vertex's constants: a genetic algorithm for the start ([ZS] section 6), then damped Gauss-Newton steps.
#pragma once

#include <cstdint>

#include "springs/vertex_motion.hpp"

namespace followthrough {

/// log ks and log kd; ks in 1/s^2, kd in 1/s.
using LogConstants = Eigen::Vector2d;

struct Found {
  LogConstants constants;
  double value;  ///< of what was minimized
};

/// Numbers between 0 and 1 that depend on seed, vertex and how many were drawn before, and on nothing else.
class VertexRandom {
 public:
  VertexRandom(std::uint64_t seed, std::uint64_t vertex) : key_(mixed(mixed(seed) ^ vertex)) {}
  double uniform() { return static_cast<double>(mixed(key_ + ++drawn_ * 0x9e3779b97f4a7c15U) >> 11U) * 0x1.0p-53; }

 private:
  static std::uint64_t mixed(std::uint64_t x) {  // the finalizer of SplitMix64
    x = (x ^ (x >> 30U)) * 0xbf58476d1ce4e5b9U;
    x = (x ^ (x >> 27U)) * 0x94d049bb133111ebU;
    return x ^ (x >> 31U);
  }
  std::uint64_t key_;
  std::uint64_t drawn_ = 0;
};

/// @brief Minimizes the vertex's weighted loss.
/// @param dt s, the shortest frame: what constants can be told apart depends on it
/// @param start where to search as well, or null
Found search_constants(const VertexMotion& motion, double dt, const SpringFitSettings& settings, VertexRandom random,
                       const LogConstants* start);

/// @brief The minimum of the loss and a pull to the usual constants, near one that search_constants has found.
/// @param pull of the squared difference of the logarithms, as a share of the motion
Found pulled_constants(const VertexMotion& motion, const Found& found, double pull);

}  // namespace followthrough
