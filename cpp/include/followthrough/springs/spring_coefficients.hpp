// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Closed form of a damped spring over one stretch of time, in every damping regime ([ZS] section 5; physics.md "Springs").
///
/// The displacement from the target, y, obeys y'' + kd y' + ks y = -(a0 + j t) where the target's acceleration is a0 + j t. With
/// the answer G to a unit impulse (G'' + kd G' + ks G = 0, G(0) = 0, G'(0) = 1), its integral I1 and the integral of that, I2:
///
///     y(t)  = A y(0) + G  y'(0) - I1 a0 - I2 j        A = 1 - ks I1
///     y'(t) = -ks G y(0) + G' y'(0) - G a0 - I1 j
#pragma once

namespace followthrough {

/// The factors above for a time t, made dimensionless by it.
struct SpringCoefficients {
  double decay;               ///< A
  double impulse;             ///< G / t
  double impulse_slope;       ///< G'
  double restoring;           ///< ks t G
  double acceleration;        ///< I1 / t^2
  double acceleration_slope;  ///< I2 / t^3
};

/// @brief Factors of a spring for the time `duration`, continuous across critical damping and free of cancellation: every one is
/// right
///   to about 1e-13 of its envelope for all constants, 0 and 1e12 included.
/// @param stiffness ks, 1/s^2, 0 or more
/// @param damping kd, 1/s, 0 or more
/// @param duration t, s, more than 0
SpringCoefficients spring_coefficients(double stiffness, double damping, double duration) noexcept;

}  // namespace followthrough
