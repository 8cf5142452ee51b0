// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/material.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include <Eigen/Eigenvalues>
#include <Eigen/Geometry>
#include <Eigen/LU>

using namespace followthrough;
using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

const Moduli constants = moduli(5e4, 0.45, 1e5);
const InvertibleStVK stvk;
const CorotationalLinear corotational;

Matrix3d random_matrix(std::mt19937& random, double size) {
  std::uniform_real_distribution<double> number(-size, size);
  return Matrix3d::NullaryExpr([&] { return number(random); });
}

Matrix3d random_rotation(std::mt19937& random) {
  std::normal_distribution<double> number;
  return Eigen::Quaterniond(number(random), number(random), number(random), number(random)).normalized().toRotationMatrix();
}

using Matrix9d = Eigen::Matrix<double, 9, 9>;

Matrix9d as_matrix(const StressDerivative& derivative) {
  Matrix9d result;
  for (int k = 0; k < 9; ++k) {
    Matrix3d change = Matrix3d::Zero();
    change(k) = 1;
    result.col(k) = derivative(change).reshaped();
  }
  return result;
}

template <typename Function>
auto central_difference(const Function& function, const Matrix3d& at, const Matrix3d& change) -> decltype(function(at)) {
  const double h = 1e-6;
  return ((function(at + h * change) - function(at - h * change)) / (2 * h));
}

}  // namespace

TEST_CASE("stress is the derivative of the energy, and its own derivative is exact") {
  std::mt19937 random(1);
  for (const Material* material : {static_cast<const Material*>(&stvk), static_cast<const Material*>(&corotational)}) {
    for (int trial = 0; trial < 200; ++trial) {
      const Matrix3d f = Matrix3d::Identity() + random_matrix(random, trial % 2 ? 0.4 : 0.05);
      if (signed_svd(f).stretches[2] < InvertibleStVK::smallest_stretch + 1e-3) continue;
      const Matrix3d change = random_matrix(random, 1.0);
      const double power = central_difference([&](const Matrix3d& g) { return material->energy_density(g, constants); }, f, change);
      CHECK(material->stress(f, constants).cwiseProduct(change).sum() == doctest::Approx(power).epsilon(1e-6).scale(constants.mu));
      const Matrix3d slope = central_difference([&](const Matrix3d& g) { return material->stress(g, constants); }, f, change);
      const Matrix3d exact = material->stress_derivative(f, constants)(change);
      CHECK((exact - slope).norm() < 1e-6 * (exact.norm() + constants.mu));
    }
  }
}

TEST_CASE("beyond the clamp the stress's derivative is exact, too") {
  std::mt19937 random(2);
  int clamped = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const Matrix3d f = random_matrix(random, 1.0);
    const Vector3d stretches = signed_svd(f).stretches;
    // Finite differences need a little room around the kink, and around the pole where two stretches cancel.
    if (((stretches.array() - InvertibleStVK::smallest_stretch).abs() < 1e-3).any() || stretches[1] + stretches[2] < 0.05) continue;
    clamped += stretches[2] < InvertibleStVK::smallest_stretch;
    const Matrix3d change = random_matrix(random, 1.0);
    const Matrix3d slope = central_difference([&](const Matrix3d& g) { return stvk.stress(g, constants); }, f, change);
    const Matrix3d exact = stvk.stress_derivative(f, constants)(change);
    CHECK((exact - slope).norm() < 1e-5 * (exact.norm() + constants.mu));
  }
  CHECK(clamped > 50);
}

TEST_CASE("beyond the clamp the stress is that of the energy with the stretches raised, turned back") {
  // From the formulas in F alone: the slope of the energy, by differences, where the stretches are raised to 0.1.
  const auto energy = [](const Matrix3d& f) {
    const Matrix3d green = 0.5 * (f.transpose() * f - Matrix3d::Identity());
    return constants.mu * green.squaredNorm() + 0.5 * constants.lambda * std::pow(green.trace(), 2) +
           1e5 * 5e4 * std::pow(std::max(1 - f.determinant(), 0.0) / 12, 3);
  };
  std::mt19937 random(6);
  std::uniform_real_distribution<double> large(0.3, 1.6), small(-1.2, 0.3);
  int clamped = 0;
  for (int trial = 0; trial < 100; ++trial) {
    Vector3d stretches(large(random), large(random), small(random));
    if (trial % 4 == 0) stretches = Vector3d(0.09, 0.05, -0.02);
    if (std::abs(stretches[2]) > std::min(stretches[0], stretches[1])) continue;  // the smallest one has the sign
    clamped += stretches[2] < 0.1;
    const Matrix3d u = random_rotation(random), v = random_rotation(random);
    const Matrix3d raised = stretches.cwiseMax(0.1).asDiagonal();
    Matrix3d slope;
    for (int k = 0; k < 9; ++k) {
      Matrix3d change = Matrix3d::Zero();
      change(k) = 1;
      slope(k) = central_difference(energy, raised, change);
    }
    const Matrix3d f = u * stretches.asDiagonal() * v.transpose();
    CHECK((stvk.stress(f, constants) - u * slope * v.transpose()).norm() < 1e-6 * (slope.norm() + constants.mu));
  }
  CHECK(clamped > 40);
}

TEST_CASE("energy and stress go on across the clamp, and the stress is the energy's slope on either side") {
  const auto at = [](double stretch) { return Matrix3d(Vector3d(1.1, 0.8, stretch).asDiagonal()); };
  const auto energy = [&](double stretch) { return stvk.energy_density(at(stretch), constants); };
  const auto pull = [&](double stretch) { return stvk.stress(at(stretch), constants)(2, 2); };
  const double h = 1e-6, clamp = InvertibleStVK::smallest_stretch, force = pull(clamp);
  CHECK(clamp == 0.1);
  CHECK(energy(clamp + 1e-12) == doctest::Approx(energy(clamp - 1e-12)).epsilon(1e-9));
  CHECK((stvk.stress(at(clamp + 1e-12), constants) - stvk.stress(at(clamp - 1e-12), constants)).norm() < 1e-9 * std::abs(force));
  CHECK((energy(clamp + h) - energy(clamp)) / h == doctest::Approx(force).epsilon(1e-4));
  CHECK((energy(clamp) - energy(clamp - h)) / h == doctest::Approx(force).epsilon(1e-6));
  for (const double stretch : {0.7, 0.3, 0.101, 0.099, 0.05, 0.0, -0.05, -0.4, -0.79}) {
    CHECK((energy(stretch + h) - energy(stretch - h)) / (2 * h) == doctest::Approx(pull(stretch)).epsilon(1e-5));
    if (stretch < clamp) CHECK(pull(stretch) == doctest::Approx(force).epsilon(1e-12));
  }
}

TEST_CASE("the energy is St. Venant-Kirchhoff's, with the resistance to compression") {
  std::mt19937 random(3);
  for (int trial = 0; trial < 100; ++trial) {
    const Matrix3d f = random_rotation(random) * (Matrix3d::Identity() + random_matrix(random, 0.2));
    const Matrix3d green = 0.5 * (f.transpose() * f - Matrix3d::Identity());
    const double squeeze = std::max(1 - f.determinant(), 0.0);
    const double expected = constants.mu * green.squaredNorm() + 0.5 * constants.lambda * std::pow(green.trace(), 2) +
                            1e5 * 5e4 * std::pow(squeeze / 12, 3);
    CHECK(stvk.energy_density(f, constants) == doctest::Approx(expected).epsilon(1e-11));
  }
}

TEST_CASE("a rotation is no deformation") {
  std::mt19937 random(4);
  for (const Material* material : {static_cast<const Material*>(&stvk), static_cast<const Material*>(&corotational)}) {
    for (int trial = 0; trial < 100; ++trial) {
      const Matrix3d rotation = random_rotation(random), f = Matrix3d::Identity() + random_matrix(random, 0.3);
      CHECK(material->stress(rotation, constants).norm() < 1e-13 * constants.lambda);
      CHECK((material->stress(rotation * f, constants) - rotation * material->stress(f, constants)).norm() <
            1e-10 * constants.lambda);
    }
  }
}

TEST_CASE("semidefinite derivatives have no negative eigenvalue and are the exact ones where those have none") {
  std::mt19937 random(5);
  int indefinite = 0;
  for (const Material* material : {static_cast<const Material*>(&stvk), static_cast<const Material*>(&corotational)}) {
    for (int trial = 0; trial < 300; ++trial) {
      const Matrix3d f = Matrix3d::Identity() + random_matrix(random, trial % 3 ? 0.02 : 1.5);
      const Matrix9d symmetric = as_matrix(material->stress_derivative(f, constants, Definiteness::kSymmetric));
      const Matrix9d projected = as_matrix(material->stress_derivative(f, constants, Definiteness::kSemidefinite));
      CHECK((symmetric - symmetric.transpose()).norm() <= 1e-12 * symmetric.norm());
      const Eigen::SelfAdjointEigenSolver<Matrix9d> before(symmetric), after(projected);
      CHECK(after.eigenvalues()[0] > -1e-12 * after.eigenvalues()[8]);
      const Matrix9d expected =
          before.eigenvectors() * before.eigenvalues().cwiseMax(0.0).asDiagonal() * before.eigenvectors().transpose();
      CHECK((projected - expected).norm() < 1e-9 * symmetric.norm());
      indefinite += before.eigenvalues()[0] < 0;
    }
  }
  CHECK(indefinite > 100);
}

TEST_CASE("equal, opposite and vanishing stretches give finite numbers") {
  for (const Material* material : {static_cast<const Material*>(&stvk), static_cast<const Material*>(&corotational)}) {
    for (const Vector3d& stretches :
         {Vector3d(0, 0, 0), Vector3d(1, 0, 0), Vector3d(1, 1, -1), Vector3d(1, 1, 0), Vector3d(1, 1e-9, -1e-9),
          Vector3d(0.1, 0.1, 0.1), Vector3d(1e6, 1e6, -1e6), Vector3d(2, 0.1, -0.1)}) {
      for (const Definiteness definiteness : {Definiteness::kExact, Definiteness::kSymmetric, Definiteness::kSemidefinite}) {
        const Matrix3d f = stretches.asDiagonal();
        CHECK(as_matrix(material->stress_derivative(f, constants, definiteness)).allFinite());
        CHECK(material->stress(f, constants).allFinite());
      }
    }
  }
}
