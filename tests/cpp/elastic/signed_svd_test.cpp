// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/signed_svd.hpp"

#include <doctest/doctest.h>

#include <cmath>
#include <random>

#include <Eigen/Geometry>
#include <Eigen/LU>

using namespace followthrough;
using Eigen::Matrix3d;
using Eigen::Vector3d;

namespace {

Matrix3d random_matrix(std::mt19937& random) {
  std::normal_distribution<double> number;
  return Matrix3d::NullaryExpr([&] { return number(random); });
}

Matrix3d random_rotation(std::mt19937& random) {
  std::normal_distribution<double> number;
  return Eigen::Quaterniond(number(random), number(random), number(random), number(random)).normalized().toRotationMatrix();
}

void check(const Matrix3d& matrix) {
  CAPTURE(matrix);
  const SignedSvd svd = signed_svd(matrix);
  const double scale = matrix.cwiseAbs().maxCoeff();
  CHECK((svd.u * svd.stretches.asDiagonal() * svd.v.transpose() - matrix).cwiseAbs().maxCoeff() <= 1e-14 * scale);
  for (const Matrix3d& rotation : {svd.u, svd.v}) {
    CHECK((rotation * rotation.transpose() - Matrix3d::Identity()).cwiseAbs().maxCoeff() < 1e-14);
    CHECK(rotation.determinant() == doctest::Approx(1.0));
  }
  CHECK(svd.stretches[0] >= svd.stretches[1] - 1e-15 * scale);
  CHECK(svd.stretches[1] >= std::abs(svd.stretches[2]) - 1e-15 * scale);
}

}  // namespace

TEST_CASE("the signed SVD gives the matrix back from proper rotations") {
  std::mt19937 random(1);
  for (int trial = 0; trial < 2000; ++trial) check(random_matrix(random));
}

TEST_CASE("the signed SVD survives flat, collapsed, inverted, zero and badly scaled matrices") {
  std::mt19937 random(2);
  const double sizes[] = {0.0, 1e-300, 1e-160, 1e-16, 1e-9, 1e-3, 1.0, -1.0, 1.0 + 1e-15, 1e9, 1e160};
  for (const double a : sizes) {
    for (const double b : sizes) {
      for (const double c : sizes) {
        check(Vector3d(a, b, c).asDiagonal());
        check(random_rotation(random) * Vector3d(a, b, c).asDiagonal() * random_rotation(random));
      }
    }
  }
  check(Matrix3d::Ones());
  check(-Matrix3d::Identity());
  CHECK(signed_svd(Matrix3d::Zero()).u == Matrix3d::Identity());
}

TEST_CASE("the smallest stretch carries the sign, and keeps its digits beside large ones") {
  std::mt19937 random(3);
  for (const double small : {-1e-7, -1e-3, -0.5, 1e-3, 1e-7}) {
    const SignedSvd svd = signed_svd(random_rotation(random) * Vector3d(2.0, 1.0, small).asDiagonal() * random_rotation(random));
    CHECK(svd.stretches[2] == doctest::Approx(small).epsilon(1e-15 / std::abs(small) + 1e-14));
  }
}
