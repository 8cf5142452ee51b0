// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A random skin on random bones whose rotations and scales are known, because they were put together from them.
#pragma once

#include <random>
#include <vector>

#include <Eigen/Geometry>

#include "followthrough/skinning/skinning.hpp"

namespace followthrough::testing {

struct RandomSkin {
  Positions rest_positions;
  IndexTable indices;
  Values weights;
  Matrices4 matrices;
  Matrices4 rest_matrices;
  Eigen::Matrix4d armature;
  std::vector<Eigen::Quaterniond> rotations;  ///< of the bones, armature space
  std::vector<Eigen::Matrix4d> in_armature;   ///< the bones' matrices, armature space
  std::mt19937_64 random;

  double between(double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); }

  Eigen::Quaterniond turn(double most) {
    const Eigen::Vector3d axis(between(-1, 1), between(-1, 1), between(-1, 1));
    return Eigen::Quaterniond(Eigen::AngleAxisd(between(-most, most), axis.normalized()));
  }

  Eigen::Vector3d vector(double low, double high) { return {between(low, high), between(low, high), between(low, high)}; }

  /// @param uneven_scale how far bones' scales are from 1, and the armature object's from even
  explicit RandomSkin(Eigen::Index vertices, Eigen::Index bones, double uneven_scale, unsigned seed = 1)
      : rest_positions(vertices, 3),
        indices(vertices, 4),
        weights(vertices, 4),
        matrices(bones, 16),
        rest_matrices(bones, 16),
        random(seed) {
    for (Eigen::Index vertex = 0; vertex < vertices; ++vertex) {
      rest_positions.row(vertex) = vector(-1, 1);
      for (Eigen::Index place = 0; place < 4; ++place) {
        indices(vertex, place) = static_cast<Index>(between(0, static_cast<double>(bones)));
        weights(vertex, place) = place <= vertex % 4 ? between(0.01, 1.5) : 0.0;
      }
    }
    armature.setIdentity();
    armature.topLeftCorner<3, 3>() = turn(3).toRotationMatrix() * vector(1 - 0.6 * uneven_scale, 1 + 2 * uneven_scale).asDiagonal();
    armature.topRightCorner<3, 1>() = vector(-2, 2);
    const Eigen::Matrix4d to_armature = armature.inverse();
    for (Eigen::Index bone = 0; bone < bones; ++bone) {
      Eigen::Affine3d rest = Eigen::Translation3d(vector(-1, 1)) * turn(3);
      const Eigen::Affine3d scale(Eigen::Scaling(vector(1 - 0.6 * uneven_scale, 1 + uneven_scale)));
      const Eigen::Quaterniond rotation = turn(1.2);
      const Eigen::Affine3d matrix = Eigen::Translation3d(vector(-0.5, 0.5)) * rotation * rest * scale * rest.inverse();
      using RowMajor4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;
      Eigen::Map<RowMajor4>(matrices.row(bone).data()) = armature * matrix.matrix() * to_armature;
      Eigen::Map<RowMajor4>(rest_matrices.row(bone).data()) = rest.matrix();
      matrices.row(bone).tail<4>() << 0, 0, 0, 1;
      rotations.push_back(rotation);
      in_armature.push_back(matrix.matrix());
    }
  }

  BoneWeights bone_weights() const { return {indices, weights}; }
  PosedBones bones() const { return {matrices, rest_matrices, armature}; }
};

}  // namespace followthrough::testing
