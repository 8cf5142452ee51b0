// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// How a spring's factors change with its constants, in every damping regime ([ZS] section 6, eqs. 15 to 20).
///
/// With G the answer to a unit impulse (spring_coefficients.hpp) and H = G * G (convolved), dG/dks = -H and dG/dkd = -H'. H is the
/// second function of [ZS] eqs. 19 and 20: with g = kd/2 and d = g^2 - ks, over the time t,
///
///     H = t^3 e^-gt (cosh e - sinh(e)/e) / (2 e^2)        e = t sqrt(d), imaginary where d < 0: entire in d
///     H' = t G/2 - g H
///
/// Every derivative of a factor is a sum of these. They are taken with respect to the constants' logarithms, so that none of them
/// over- or underflows, whatever the constants are.
#pragma once

#include "followthrough/springs/spring_coefficients.hpp"

namespace followthrough {

/// Derivatives of each factor.
struct SpringDerivatives {
  SpringCoefficients stiffness;  ///< ks d/dks, which is d/d log ks
  SpringCoefficients damping;    ///< kd d/dkd
};

/// @brief Derivatives of a spring's factors, continuous across critical damping and free of cancellation: right to about 1e-12 of
///   their envelope for all constants, 0 and 1e12 included.
/// @param stiffness ks, 1/s^2, 0 or more
/// @param damping kd, 1/s, 0 or more
/// @param duration t, s, more than 0
/// @param factors what spring_coefficients gives for the same constants
SpringDerivatives spring_derivatives(double stiffness, double damping, double duration, const SpringCoefficients& factors) noexcept;

}  // namespace followthrough
