// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Isotropic elastic materials as functions of the deformation gradient F = U diag(stretches) V^T (signed_svd.hpp). A material says
/// how the principal stretches push back; energy, stress and its exact derivative in world axes follow for all of them alike.
#pragma once

#include <Eigen/Core>

#include "followthrough/elastic/signed_svd.hpp"

namespace followthrough {

/// Material constants of one element.
struct Moduli {
  double mu = 0;                      ///< second Lame parameter, Pa
  double lambda = 0;                  ///< first Lame parameter, Pa
  double compression_resistance = 0;  ///< c, Pa
};

/// @param youngs_modulus E, Pa
/// @param poisson_ratio -1 to 0.5, both excluded
/// @param compression_resistance c over E
Moduli moduli(double youngs_modulus, double poisson_ratio, double compression_resistance);

/// What the principal stretches do. Off-diagonal parts come in pairs of axes: entry k belongs to the two axes that are not k.
struct PrincipalResponse {
  double energy_density = 0;          ///< J/m3
  Eigen::Vector3d stress;             ///< principal first Piola-Kirchhoff stresses p, Pa
  Eigen::Matrix3d stretch_stiffness;  ///< d p_i / d stretch_j, Pa
  Eigen::Vector3d flip;               ///< (p_i - p_j) / (stretch_i - stretch_j), or its limit, Pa
  Eigen::Vector3d twist;              ///< (p_i + p_j) / (stretch_i + stretch_j), or its limit, Pa
};

/// Derivative of the stress, kept in principal axes, where it is the 3x3 block of the stretches and one 2x2 block a pair of axes.
struct StressDerivative {
  Eigen::Matrix3d u, v;
  Eigen::Matrix3d stretch_stiffness;  ///< as in PrincipalResponse
  Eigen::Vector3d along, across;      ///< d P_ij = along_k d F_ij + across_k d F_ji, k the third axis

  /// @return dP for a change of the deformation gradient
  Eigen::Matrix3d operator()(const Eigen::Matrix3d& change) const;
};

/// What may be done to a stress derivative so that linear solvers like it.
enum class Definiteness {
  kExact,         ///< nothing. Beyond a material's clamp it is not symmetric
  kSymmetric,     ///< its symmetric part; the exact one wherever an energy exists
  kSemidefinite,  ///< its symmetric part with negative eigenvalues raised to zero
  kConvex         ///< semidefinite too, and cheaper where the material has a closed form: without the terms that can be negative
};

class Material {
 public:
  virtual ~Material() = default;

  /// @param stretches as signed_svd gives them
  virtual PrincipalResponse respond(const Eigen::Vector3d& stretches, const Moduli& constants) const = 0;

  /// @param deformation_gradient F, finite
  /// @return J per cubic metre at rest
  double energy_density(const Eigen::Matrix3d& deformation_gradient, const Moduli& constants) const;

  /// @return first Piola-Kirchhoff stress P, Pa
  Eigen::Matrix3d stress(const Eigen::Matrix3d& deformation_gradient, const Moduli& constants) const;

  /// @return dP/dF
  StressDerivative stress_derivative(const Eigen::Matrix3d& deformation_gradient, const Moduli& constants,
                                     Definiteness definiteness = Definiteness::kExact) const;
};

/// St. Venant-Kirchhoff with compression resistance, mu E:E + lambda/2 tr(E)^2 + c ((1 - J)/12)^3 where J < 1, made invertible:
/// stretches below `smallest_stretch` push back as if they were it. Beyond that clamp no energy exists whose gradient the stress
/// is; the one reported continues it linearly.
class InvertibleStVK final : public Material {
 public:
  static constexpr double smallest_stretch = 0.1;
  PrincipalResponse respond(const Eigen::Vector3d& stretches, const Moduli& constants) const override;
};

/// Corotational linear elasticity, mu |F - R|^2 + lambda/2 tr(R^T F - I)^2: cheap and soft under pressure.
class CorotationalLinear final : public Material {
 public:
  PrincipalResponse respond(const Eigen::Vector3d& stretches, const Moduli& constants) const override;
};

}  // namespace followthrough
