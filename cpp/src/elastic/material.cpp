// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/material.hpp"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Where two stretches cancel (the smallest one negative), the rotation is not unique and the twist has a pole. Derivatives are
// those of a sum not smaller than this.
constexpr double smallest_stretch_sum = 1e-6;

constexpr int next[] = {1, 2, 0};
constexpr int after_next[] = {2, 0, 1};

Matrix3d semidefinite(const Matrix3d& symmetric) {
  // Sylvester's criterion is cheap and true almost always.
  const double minor = symmetric(0, 0) * symmetric(1, 1) - symmetric(0, 1) * symmetric(1, 0);
  if (symmetric(0, 0) > 0 && minor > 0 && symmetric.determinant() > 0) return symmetric;
  Eigen::SelfAdjointEigenSolver<Matrix3d> eigen(symmetric);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0.0).asDiagonal() * eigen.eigenvectors().transpose();
}

}  // namespace

Moduli moduli(double youngs_modulus, double poisson_ratio, double compression_resistance) {
  return {youngs_modulus / (2 * (1 + poisson_ratio)),
          youngs_modulus * poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio)),
          youngs_modulus * compression_resistance};
}

Matrix3d StressDerivative::operator()(const Matrix3d& change) const {
  const Matrix3d df = u.transpose() * change * v;
  Matrix3d dp;
  dp.diagonal() = stretch_stiffness * df.diagonal();
  for (int k = 0; k < 3; ++k) {
    const int i = next[k], j = after_next[k];
    dp(i, j) = along[k] * df(i, j) + across[k] * df(j, i);
    dp(j, i) = along[k] * df(j, i) + across[k] * df(i, j);
  }
  return u * dp * v.transpose();
}

double Material::energy_density(const Matrix3d& deformation_gradient, const Moduli& constants) const {
  return respond(signed_svd(deformation_gradient).stretches, constants).energy_density;
}

Matrix3d Material::stress(const Matrix3d& deformation_gradient, const Moduli& constants) const {
  const SignedSvd svd = signed_svd(deformation_gradient);
  return svd.u * respond(svd.stretches, constants).stress.asDiagonal() * svd.v.transpose();
}

StressDerivative Material::stress_derivative(const Matrix3d& deformation_gradient, const Moduli& constants,
                                             Definiteness definiteness) const {
  const SignedSvd svd = signed_svd(deformation_gradient);
  PrincipalResponse response = respond(svd.stretches, constants);
  if (definiteness != Definiteness::kExact) {
    response.stretch_stiffness = (0.5 * (response.stretch_stiffness + response.stretch_stiffness.transpose())).eval();
  }
  if (definiteness == Definiteness::kSemidefinite || definiteness == Definiteness::kConvex) {
    response.stretch_stiffness = semidefinite(response.stretch_stiffness);
    response.flip = response.flip.cwiseMax(0.0);
    response.twist = response.twist.cwiseMax(0.0);
  }
  return {svd.u, svd.v, response.stretch_stiffness, 0.5 * (response.flip + response.twist), 0.5 * (response.flip - response.twist)};
}

PrincipalResponse InvertibleStVK::respond(const Vector3d& stretches, const Moduli& constants) const {
  const auto [mu, lambda, resistance] = constants;
  const Vector3d s = stretches.cwiseMax(smallest_stretch);
  const Vector3d green = 0.5 * (s.cwiseAbs2().array() - 1).matrix();
  const double trace = green.sum(), volume = s.prod();
  const double squeeze = std::max(1 - volume, 0.0);
  const double pressure = -resistance * squeeze * squeeze / 576;  // d energy / d volume
  const double bulk = resistance * squeeze / 288;                 // its derivative
  const Vector3d areas(s[1] * s[2], s[2] * s[0], s[0] * s[1]);
  PrincipalResponse response;
  response.stress = s.cwiseProduct((2 * mu * green.array() + lambda * trace).matrix()) + pressure * areas;
  response.energy_density = mu * green.squaredNorm() + 0.5 * lambda * trace * trace + resistance * std::pow(squeeze / 12, 3) +
                            response.stress.dot(stretches - s);
  response.stretch_stiffness = lambda * s * s.transpose() + bulk * areas * areas.transpose();
  for (int k = 0; k < 3; ++k) {
    const int i = next[k], j = after_next[k];
    response.stretch_stiffness(k, k) += 2 * mu * (green[k] + s[k] * s[k]) + lambda * trace;
    response.stretch_stiffness(i, j) += pressure * s[k];
    response.stretch_stiffness(j, i) += pressure * s[k];
    const double squares = s[i] * s[i] + s[j] * s[j] - 1, product = s[i] * s[j];
    const double apart = stretches[i] - stretches[j], sum = stretches[i] + stretches[j];
    double slope = stretches[i] > smallest_stretch ? 1.0 : 0.0;
    if (apart != 0) slope = (s[i] - s[j]) / apart;
    response.flip[k] = slope * (mu * (squares + product) + lambda * trace - pressure * s[k]);
    const double lift = stretches[i] == s[i] && stretches[j] == s[j] ? 1.0 : (s[i] + s[j]) / std::max(sum, smallest_stretch_sum);
    response.twist[k] = lift * (mu * (squares - product) + lambda * trace + pressure * s[k]);
  }
  for (int j = 0; j < 3; ++j) {
    if (stretches[j] < smallest_stretch) response.stretch_stiffness.col(j).setZero();
  }
  return response;
}

PrincipalResponse CorotationalLinear::respond(const Vector3d& stretches, const Moduli& constants) const {
  const Vector3d strain = stretches.array() - 1;
  const double trace = strain.sum();
  PrincipalResponse response;
  response.energy_density = constants.mu * strain.squaredNorm() + 0.5 * constants.lambda * trace * trace;
  response.stress = (2 * constants.mu * strain.array() + constants.lambda * trace).matrix();
  response.stretch_stiffness.setConstant(constants.lambda);
  response.stretch_stiffness.diagonal().array() += 2 * constants.mu;
  response.flip.setConstant(2 * constants.mu);
  for (int k = 0; k < 3; ++k) {
    const double sum = stretches[next[k]] + stretches[after_next[k]];
    response.twist[k] = (response.stress[next[k]] + response.stress[after_next[k]]) / std::max(sum, smallest_stretch_sum);
  }
  return response;
}

}  // namespace followthrough
