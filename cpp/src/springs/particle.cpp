// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/particle.hpp"

#include "followthrough/springs/spring_coefficients.hpp"

namespace followthrough {

CubicTarget CubicTarget::hermite(const Eigen::Vector3d& start, const Eigen::Vector3d& end, const Eigen::Vector3d& start_velocity,
                                 const Eigen::Vector3d& end_velocity, double duration) {
  const Eigen::Vector3d mean_velocity = (end - start) / duration;
  const Eigen::Vector3d bend = start_velocity + end_velocity - 2.0 * mean_velocity;
  return {start, start_velocity, (mean_velocity - start_velocity - bend) / duration, bend / (duration * duration)};
}

Eigen::Vector3d CubicTarget::position(double t) const { return offset + t * (linear + t * (quadratic + t * cubic)); }

Eigen::Vector3d CubicTarget::velocity(double t) const { return linear + t * (2.0 * quadratic + (3.0 * t) * cubic); }

Eigen::Vector3d CubicTarget::acceleration(double t) const { return 2.0 * quadratic + (6.0 * t) * cubic; }

Particle advance(const Particle& particle, const CubicTarget& target, double from, double to, double stiffness, double damping) {
  const double duration = to - from;
  if (!(duration > 0.0)) {
    return particle;
  }
  const SpringCoefficients k = spring_coefficients(stiffness, damping, duration);
  const Eigen::Vector3d lag = particle.position - target.position(from);
  const Eigen::Vector3d lag_rate = (particle.velocity - target.velocity(from)) * duration;
  const Eigen::Vector3d constant = target.acceleration(from) * (duration * duration);
  const Eigen::Vector3d linear = 6.0 * target.cubic * (duration * duration * duration);
  return {target.position(to) + k.decay * lag + k.impulse * lag_rate - k.acceleration * constant - k.acceleration_slope * linear,
          target.velocity(to) +
              (k.impulse_slope * lag_rate - k.restoring * lag - k.impulse * constant - k.acceleration * linear) / duration};
}

}  // namespace followthrough
