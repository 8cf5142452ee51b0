// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/skinning/skinning.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <limits>

#include "followthrough/errors.hpp"
#include "random_skin.hpp"

using namespace followthrough;
using followthrough::testing::RandomSkin;

namespace {

using Real = long double;
using Vector3 = Eigen::Matrix<Real, 3, 1>;
using Matrix3 = Eigen::Matrix<Real, 3, 3>;
using Quaternion = Eigen::Quaternion<Real>;

/// Where a point on one vertex's bones goes, step by step as the definition has it, in extended precision: every bone becomes the
/// rigid motion that turns as the bone does and carries this very point where the bone's matrix does; dual quaternions blend those.
Vector3 pose_by_definition(const RandomSkin& skin, Eigen::Index vertex, const Vector3& rest, Skinning skinning) {
  const Matrix3 armature = skin.armature.topLeftCorner<3, 3>().cast<Real>();
  const Vector3 origin = skin.armature.topRightCorner<3, 1>().cast<Real>();
  const Vector3 point = armature.inverse() * (rest - origin);
  Real total = 0;
  Vector3 linear = Vector3::Zero();
  Quaternion real(0, 0, 0, 0), dual(0, 0, 0, 0);
  for (Eigen::Index place = 0; place < skin.weights.cols(); ++place) {
    const Real weight = skin.weights(vertex, place);
    const auto bone = static_cast<std::size_t>(skin.indices(vertex, place));
    const Eigen::Matrix<Real, 4, 4> matrix = skin.in_armature[bone].cast<Real>();
    const Vector3 goal = matrix.topLeftCorner<3, 3>() * point + matrix.topRightCorner<3, 1>();
    const Quaternion rotation = skin.rotations[bone].cast<Real>();
    const Vector3 translation = goal - rotation._transformVector(point);
    const Quaternion half(0, translation.x() / 2, translation.y() / 2, translation.z() / 2);
    const Real side = real.dot(rotation) < 0 ? -weight : weight;
    real.coeffs() += side * rotation.coeffs();
    dual.coeffs() += side * (half * rotation).coeffs();
    linear += weight * goal;
    total += weight;
  }
  Vector3 posed = linear / total;
  if (skinning == Skinning::dual_quaternion) {
    const Real length = real.norm();
    real.coeffs() /= length;
    dual.coeffs() /= length;
    posed = real._transformVector(point) + 2 * (dual * real.conjugate()).vec();
  }
  return armature * posed + origin;
}

Vector3 row(const RandomSkin& skin, Eigen::Index vertex) { return skin.rest_positions.row(vertex).transpose().cast<Real>(); }

constexpr Skinning both[] = {Skinning::linear, Skinning::dual_quaternion};

}  // namespace

TEST_SUITE("skinning") {
  TEST_CASE("posed positions are the definition's") {
    for (const Skinning skinning : both) {
      for (const double uneven_scale : {0.0, 0.5, 1.0}) {
        const RandomSkin skin(300, 7, uneven_scale);
        const Positions posed = pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning);
        for (Eigen::Index vertex = 0; vertex < posed.rows(); ++vertex) {
          const Vector3 expected = pose_by_definition(skin, vertex, row(skin, vertex), skinning);
          CHECK((posed.row(vertex).transpose() - expected.cast<double>()).norm() <=
                1e-13 * (1 + static_cast<double>(expected.norm())));
        }
      }
    }
  }

  TEST_CASE("Jacobians are the definition's central differences") {
    for (const Skinning skinning : both) {
      const RandomSkin skin(300, 7, 1.0);
      const Matrices3 jacobians = skinning_jacobians(300, skin.bone_weights(), skin.bones(), skinning);
      const Real step = 1e-5L;
      for (Eigen::Index vertex = 0; vertex < jacobians.rows(); ++vertex) {
        Eigen::Matrix3d slopes;
        for (int axis = 0; axis < 3; ++axis) {
          const Vector3 offset = step * Vector3::Unit(axis);
          const Vector3 slope = (pose_by_definition(skin, vertex, row(skin, vertex) + offset, skinning) -
                                 pose_by_definition(skin, vertex, row(skin, vertex) - offset, skinning)) /
                                (2 * step);
          slopes.col(axis) = slope.cast<double>();
        }
        const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> ours(jacobians.row(vertex).data());
        CHECK((ours - slopes).norm() <= 1e-11 * (1 + slopes.norm()));
      }
    }
  }

  TEST_CASE("one rigid motion of all bones moves every vertex rigidly") {
    RandomSkin skin(100, 5, 0.0);
    const Eigen::Affine3d motion = Eigen::Translation3d(3, -1, 2) * skin.turn(3);
    for (Eigen::Index bone = 0; bone < 5; ++bone) {
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(skin.matrices.row(bone).data()) = motion.matrix();
    }
    for (const Skinning skinning : both) {
      const Positions posed = pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning);
      const Positions expected = (skin.rest_positions * motion.linear().transpose()).rowwise() + motion.translation().transpose();
      CHECK((posed - expected).cwiseAbs().maxCoeff() < 1e-14 * 8);
    }
  }

  TEST_CASE("results do not depend on the number of threads") {
    const RandomSkin skin(40000, 9, 1.0);  // enough for the work to be shared
    const int threads = omp_get_max_threads();
    for (const Skinning skinning : both) {
      omp_set_num_threads(1);
      const Positions alone = pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning);
      const Matrices3 jacobians = skinning_jacobians(40000, skin.bone_weights(), skin.bones(), skinning);
      for (const int count : {2, 3, 4}) {
        omp_set_num_threads(count);
        CHECK(pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning) == alone);
        CHECK(skinning_jacobians(40000, skin.bone_weights(), skin.bones(), skinning) == jacobians);
      }
    }
    omp_set_num_threads(threads);
  }

  TEST_CASE("what cannot be used is refused by name, in the loop too") {
    const RandomSkin good(50, 5, 0.5);
    const auto refused = [](const RandomSkin& skin, const char* argument) {
      try {
        pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), Skinning::dual_quaternion);
      } catch (const InvalidInput& error) {
        CHECK(error.argument() == argument);
        return;
      }
      FAIL_CHECK("accepted a bad " << argument);
    };
    RandomSkin skin = good;
    skin.indices(49, 0) = 5;
    refused(skin, "bone_indices");
    skin = good;
    skin.indices(49, 0) = std::numeric_limits<Index>::min();
    refused(skin, "bone_indices");
    skin = good;
    skin.weights(20, 1) = -1e-9;
    refused(skin, "bone_weights");
    skin = good;
    skin.weights(20, 1) = std::numeric_limits<double>::quiet_NaN();
    refused(skin, "bone_weights");
    skin = good;
    skin.rest_positions(20, 1) = std::numeric_limits<double>::infinity();
    refused(skin, "rest_positions");
    skin = good;
    skin.matrices(2, 3) = std::numeric_limits<double>::quiet_NaN();
    refused(skin, "bone_matrices");
    skin = good;
    skin.matrices.col(3).setConstant(1e308);
    skin.matrices.leftCols<3>().setConstant(1e308);
    refused(skin, "bone_matrices");
    skin = good;
    skin.rest_matrices.row(1) *= 1.0;
    skin.rest_matrices(1, 0) += 0.1;
    refused(skin, "bone_rest_matrices");
    skin = good;
    skin.armature.col(0) = skin.armature.col(1);
    refused(skin, "armature_matrix");
    skin = good;
    skin.weights.conservativeResize(49, 4);
    refused(skin, "bone_indices");
    skin.indices.conservativeResize(49, 4);
    refused(skin, "bone_weights");
  }
}
