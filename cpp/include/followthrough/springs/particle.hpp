// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One particle on a zero-restlength spring whose target runs along a cubic ([ZS] sections 4 and 5): the plain form of what Springs
/// does to arrays of them, for any stretch of the frame.
#pragma once

#include <Eigen/Core>

namespace followthrough {

/// A target's motion over one frame: offset + linear t + quadratic t^2 + cubic t^3, t in seconds from the frame's start.
struct CubicTarget {
  Eigen::Vector3d offset, linear, quadratic, cubic;

  /// @brief The cubic through both ends with the given velocities there (Hermite).
  /// @param start, end positions, m
  /// @param start_velocity, end_velocity m/s
  /// @param duration of the frame, s
  static CubicTarget hermite(const Eigen::Vector3d& start, const Eigen::Vector3d& end, const Eigen::Vector3d& start_velocity,
                             const Eigen::Vector3d& end_velocity, double duration);

  Eigen::Vector3d position(double t) const;
  Eigen::Vector3d velocity(double t) const;
  Eigen::Vector3d acceleration(double t) const;
};

struct Particle {
  Eigen::Vector3d position;  ///< m
  Eigen::Vector3d velocity;  ///< m/s
};

/// @brief Takes a particle from one time of the frame to a later one, exactly.
/// @param particle at time `from`
/// @param target the spring's other end
/// @param from, to s since the frame's start
/// @param stiffness ks, 1/s^2, 0 or more
/// @param damping kd, 1/s, 0 or more
/// @return the particle at time `to`
Particle advance(const Particle& particle, const CubicTarget& target, double from, double to, double stiffness, double damping);

}  // namespace followthrough
