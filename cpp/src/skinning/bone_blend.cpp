// SPDX-License-Identifier: GPL-3.0-or-later
#include "skinning/bone_blend.hpp"

#include <cmath>
#include <string>

#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Matrix4d;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using LinearRow = Eigen::Matrix<double, 1, 12>;
using DualRow = Eigen::Matrix<double, 1, 20>;
using Matrix34 = Eigen::Matrix<double, 3, 4, Eigen::RowMajor>;
using Matrix4 = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

/// Objects whose scale is even to within Blender's single precision.
constexpr double even_scale_tolerance = 1e-6;
/// How far rest matrices may be from rotations of each other; files round them.
constexpr double rotation_tolerance = 1e-3;

Matrix4d matrix_at(ConstMatrices4 matrices, Eigen::Index row) { return Eigen::Map<const Matrix4>(matrices.row(row).data()); }

void require_affine(std::string_view argument, ConstMatrices4 matrices) {
  require_finite(argument, matrices);
  for (Eigen::Index row = 0; row < matrices.rows(); ++row) {
    if ((matrices.row(row).tail<4>() - Eigen::RowVector4d(0, 0, 0, 1)).cwiseAbs().maxCoeff() > 1e-6) {
      throw InvalidInput(argument, "matrix " + std::to_string(row) + " is not affine, expected 0 0 0 1 in its last row");
    }
  }
}

/// The rotation of posed bone axes (columns, armature space) as Blender splits it off. Y keeps its direction; X gives the plane
/// unless it leans along Y by a unit of length or more, then Z does unless it leans along X as far, and after that any direction
/// does. Where axes are flattened to nothing Blender's own choice is rounding noise; ours is the next axis that is left.
Matrix3d rotation_of_axes(const Matrix3d& axes) {
  const double flat = 1e-9 * axes.norm();
  const Vector3d along = axes.col(1);
  if (!(along.norm() > flat)) return Matrix3d::Identity();
  const Vector3d y = along.normalized();
  const Vector3d from_x = axes.col(0).cross(y);
  const Vector3d from_z = y.cross(axes.col(2));
  Vector3d x, z;
  if (y.dot(axes.col(0)) < 1.0 && from_x.norm() > flat) {
    z = from_x.normalized();
    x = y.cross(z);
  } else {
    const bool trusts_z = axes.col(0).dot(axes.col(2)) < 1.0 && from_z.norm() > flat;
    const Vector3d other = y.cross(Vector3d(y.y(), y.z(), y.x()));
    x = trusts_z ? from_z.normalized() : (other.norm() > flat ? other.normalized() : y.unitOrthogonal());
    z = x.cross(y);
  }
  return (Matrix3d() << x, y, z).finished();
}

bool is_rotation(const Matrix3d& matrix, double tolerance) {
  return matrix.determinant() > 0 && (matrix.transpose() * matrix - Matrix3d::Identity()).norm() <= tolerance;
}

/// Row of the table for a bone whose matrix does `excess` beyond turning by `rotation`, both in the space of the blend.
DualRow dual_row(const Quaterniond& rotation, const Matrix34& excess) {
  DualRow row;
  row.head<4>() << rotation.w(), rotation.x(), rotation.y(), rotation.z();
  Eigen::Map<Matrix4> product(row.data() + 4);
  product.row(0) = -rotation.vec().transpose() * excess;
  for (int column = 0; column < 4; ++column) {
    const Vector3d t = excess.col(column);
    product.col(column).tail<3>() = rotation.w() * t + t.cross(rotation.vec());
  }
  return row;
}

auto sum_kernel(Skinning skinning) {
  const bool linear = skinning == Skinning::linear;
  return linear ? FOLLOWTHROUGH_KERNEL(sum_bone_matrices) : FOLLOWTHROUGH_KERNEL(sum_bone_quaternions);
}

}  // namespace

BoneBlend::BoneBlend(const BoneWeights& weights, const PosedBones& bones, Skinning skinning)
    : weights_(weights), skinning_(skinning), bone_count_(bones.matrices.rows()) {
  require_rows("bone_indices", weights.indices.rows(), weights.weights.rows());
  if (weights.indices.cols() != weights.weights.cols()) {
    throw InvalidInput("bone_indices", "has " + std::to_string(weights.indices.cols()) + " columns, expected " +
                                           std::to_string(weights.weights.cols()) + " as bone_weights has");
  }
  require_affine("bone_matrices", bones.matrices);
  if (bones.rest_matrices.rows() != 0) {
    require_rows("bone_rest_matrices", bones.rest_matrices.rows(), bone_count_);
    require_affine("bone_rest_matrices", bones.rest_matrices);
  }
  sum_rows_ = sum_kernel(skinning);
  if (skinning == Skinning::linear) {
    prepare_linear(bones);
  } else {
    prepare_dual_quaternions(bones);
  }
}

void BoneBlend::prepare_linear(const PosedBones& bones) {
  table_.resize(bone_count_ + 1, 12);
  table_.topRows(bone_count_) = bones.matrices.leftCols<12>();
  Eigen::Map<Matrix34>(table_.row(bone_count_).data()) = Matrix34::Identity();
}

void BoneBlend::prepare_dual_quaternions(const PosedBones& bones) {
  if (!bones.armature.allFinite()) throw InvalidInput("armature_matrix", "holds a number that is not finite");
  const Matrix3d armature = bones.armature.topLeftCorner<3, 3>();
  const double determinant = armature.determinant();
  if (!(std::abs(determinant) > 1e-12 * std::pow(armature.norm(), 3))) {
    throw InvalidInput("armature_matrix", "is singular, expected one that can be inverted");
  }
  const Matrix3d turn = armature / std::cbrt(std::abs(determinant));
  const Matrix3d to_armature = armature.inverse();
  blends_in_object_space_ = is_rotation(turn, even_scale_tolerance);
  if (!blends_in_object_space_) {
    to_blend_ = to_armature;
    from_blend_ = armature;
  }
  const Quaterniond turn_to_blend = blends_in_object_space_ ? Quaterniond(turn).normalized() : Quaterniond::Identity();

  table_.resize(bone_count_ + 1, 20);
  table_.row(bone_count_) = dual_row(Quaterniond::Identity(), Matrix34::Zero());
  for (Eigen::Index bone = 0; bone < bone_count_; ++bone) {
    Matrix3d rest = Matrix3d::Identity();
    if (bones.rest_matrices.rows() > 0) rest = matrix_at(bones.rest_matrices, bone).topLeftCorner<3, 3>();
    if (!is_rotation(rest, rotation_tolerance)) {
      throw InvalidInput("bone_rest_matrices", "matrix " + std::to_string(bone) +
                                                   " is not a rotation, expected a bone's rest axes in the armature's space");
    }
    const Matrix4d matrix = matrix_at(bones.matrices, bone);
    const Matrix3d linear = matrix.topLeftCorner<3, 3>();
    const Quaterniond in_armature =
        Quaterniond(rotation_of_axes(to_armature * linear * armature * rest)) * Quaterniond(rest).normalized().conjugate();
    const Quaterniond rotation = (turn_to_blend * in_armature * turn_to_blend.conjugate()).normalized();
    Matrix34 excess;
    excess.leftCols<3>() = to_blend_ * linear - rotation.toRotationMatrix() * to_blend_;
    excess.col(3) = to_blend_ * matrix.topRightCorner<3, 1>();
    table_.row(bone) = dual_row(rotation, excess);
  }
}

double BoneBlend::sum_rows(Eigen::Index vertex, double* sum, bool& valid) const {
  const Eigen::Index places = weights_.weights.cols();
  return sum_rows_({table_.data(), bone_count_, weights_.indices.data() + vertex * weights_.indices.outerStride(),
                    weights_.weights.data() + vertex * weights_.weights.outerStride(), places},
                   sum, valid);
}

std::optional<BoneRows> BoneBlend::linear_rows() const {
  const Eigen::Index places = weights_.weights.cols();
  const bool dense = vertex_count() < 2 || (weights_.indices.outerStride() == places && weights_.weights.outerStride() == places);
  if (skinning_ != Skinning::linear || !dense) return std::nullopt;
  return BoneRows{table_.data(), bone_count_, weights_.indices.data(), weights_.weights.data(), places};
}

VertexTransform BoneBlend::linear_transform(Eigen::Index vertex, bool& valid) const {
  LinearRow sum;
  const double total = sum_rows(vertex, sum.data(), valid);
  if (!(total > least_total_weight)) return {Matrix3d::Identity(), Vector3d::Zero()};
  sum *= 1.0 / total;
  const Eigen::Map<const Matrix34> blended(sum.data());
  return {blended.leftCols<3>(), blended.col(3)};
}

VertexTransform BoneBlend::dual_quaternion_transform(Eigen::Index vertex, bool& valid) const {
  DualRow sum;
  const double total = sum_rows(vertex, sum.data(), valid);
  if (!(total > least_total_weight)) return {Matrix3d::Identity(), Vector3d::Zero()};

  // The weights' total cancels: rotation and translation are both quotients of squares of the sum.
  const double w = sum[0];
  const Vector3d v = sum.segment<3>(1);
  const double inverse_square = 1.0 / sum.head<4>().squaredNorm();
  const Eigen::Map<const Matrix4> dual(sum.data() + 4);
  // Vector part of dual * conjugate(q), column by column, and the rotation, both over the square of q.
  Matrix34 moved = w * dual.bottomRows<3>() - v * dual.row(0);
  moved.row(0) += v.y() * dual.row(3) - v.z() * dual.row(2);
  moved.row(1) += v.z() * dual.row(1) - v.x() * dual.row(3);
  moved.row(2) += v.x() * dual.row(2) - v.y() * dual.row(1);
  moved *= inverse_square;
  const Vector3d turn = 2.0 * inverse_square * v;
  const Vector3d around = w * turn;
  Matrix3d rotation = turn * v.transpose();
  rotation.diagonal().array() += 1.0 - turn.dot(v);
  rotation(2, 1) += around.x();
  rotation(1, 2) -= around.x();
  rotation(0, 2) += around.y();
  rotation(2, 0) -= around.y();
  rotation(1, 0) += around.z();
  rotation(0, 1) -= around.z();
  if (blends_in_object_space_) return {rotation + moved.leftCols<3>(), moved.col(3)};
  return {from_blend_ * (rotation * to_blend_ + moved.leftCols<3>()), from_blend_ * moved.col(3)};
}

void BoneBlend::require_weights() const {
  for (Eigen::Index vertex = 0; vertex < weights_.weights.rows(); ++vertex) {
    for (Eigen::Index place = 0; place < weights_.weights.cols(); ++place) {
      const double weight = weights_.weights(vertex, place);
      const Index index = weights_.indices(vertex, place);
      const std::string row = "row " + std::to_string(vertex) + " holds ";
      if (!std::isfinite(weight) || weight < 0.0) {
        throw InvalidInput("bone_weights", row + std::to_string(weight) + ", expected finite numbers, 0 or more");
      }
      if (weight > 0.0 && index != no_bone && (index < 0 || index >= bone_count_)) {
        throw InvalidInput("bone_indices", row + "index " + std::to_string(index) + ", expected 0 to " +
                                               std::to_string(bone_count_ - 1) + ", or -1 for no bone");
      }
    }
  }
}

}  // namespace followthrough
