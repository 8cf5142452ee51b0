// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One pose, prepared for blending: whatever depends on a bone alone is computed once, so that a vertex only sums table rows.
#pragma once

#include <optional>

#include <Eigen/Geometry>

#include "followthrough/skinning/skinning.hpp"
#include "skinning/bone_rows.hpp"

namespace followthrough {

/// A vertex's map from rest to posed position.
struct VertexTransform {
  Eigen::Matrix3d linear;
  Eigen::Vector3d translation;
};

class BoneBlend {
 public:
  /// @throws InvalidInput as `pose_vertices`, for what concerns the bones alone and the shape of the weights
  BoneBlend(const BoneWeights& weights, const PosedBones& bones, Skinning skinning);

  Eigen::Index vertex_count() const { return weights_.weights.rows(); }

  /// What one `vertex_transform` takes, roughly (see worthwhile_threads).
  double nanoseconds() const {
    return skinning_ == Skinning::linear ? 5.0 + 6.0 * static_cast<double>(weights_.weights.cols())
                                         : 30.0 + 10.0 * static_cast<double>(weights_.weights.cols());
  }

  /// @brief The transform of one vertex.
  /// @param valid set to false, and otherwise left alone, where the vertex's indices or weights cannot be used; the result is then
  ///   meaningless. `require_weights` tells what is wrong.
  VertexTransform vertex_transform(Eigen::Index vertex, bool& valid) const {
    return skinning_ == Skinning::linear ? linear_transform(vertex, valid) : dual_quaternion_transform(vertex, valid);
  }

  /// @return the table of a linear blend and where the first vertex hangs on it, or nothing for dual quaternions. Valid as long as
  ///   this and the weights are
  std::optional<BoneRows> linear_rows() const;

  /// @throws InvalidInput naming the first vertex whose indices or weights cannot be used
  void require_weights() const;

 private:
  void prepare_linear(const PosedBones& bones);
  void prepare_dual_quaternions(const PosedBones& bones);
  VertexTransform linear_transform(Eigen::Index vertex, bool& valid) const;
  VertexTransform dual_quaternion_transform(Eigen::Index vertex, bool& valid) const;
  /// Sums a vertex's rows of the table by weight, as both blends do; returns the total weight.
  double sum_rows(Eigen::Index vertex, double* sum, bool& valid) const;

  BoneWeights weights_;
  Skinning skinning_;
  Eigen::Index bone_count_;
  decltype(&baseline::sum_bone_matrices) sum_rows_ = nullptr;
  /// (b+1,12) or (b+1,20), the last row is `no_bone`. Linear: the 3x4 matrix. Dual quaternions: the rotation q (w, x, y, z), then
  /// the 4x4 matrix that takes a homogeneous rest position p to the quaternion (0, t(p)) q, where t(p) = M p - R p is the
  /// translation that makes the rigid motion (R, t) carry p where the bone's matrix M does.
  Values table_;
  /// Object space to the space of the blend and back, linear part: dual quaternions blend in the armature's space, but a turn and
  /// an even scale make no difference to them, so unless there is more between the two spaces they blend in object space.
  Eigen::Matrix3d to_blend_ = Eigen::Matrix3d::Identity();
  Eigen::Matrix3d from_blend_ = Eigen::Matrix3d::Identity();
  bool blends_in_object_space_ = true;
};

}  // namespace followthrough
