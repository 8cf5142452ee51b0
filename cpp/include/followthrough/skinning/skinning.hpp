// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Posing by bones, as Blender's Armature modifier does it: linear blend, and dual quaternions ("preserve volume", Kavan et al.
/// 2008) with bone scale. Everything is given and returned in the mesh's object space.
///
/// With the armature object's matrix A, the mesh object's matrix O, a bone's rest matrix B (armature space, `Bone.matrix_local`)
/// and its posed matrix P (`PoseBone.matrix`), `PosedBones` holds
///
///     armature      = O^-1 A
///     matrices      = armature P B^-1 armature^-1
///     rest_matrices = B
///
/// A vertex's map from rest to posed position is affine in both methods, so its Jacobian does not depend on the vertex's own
/// position and inverse skinning is exact.
#pragma once

#include "followthrough/types.hpp"

namespace followthrough {

enum class Skinning { linear, dual_quaternion };

/// Stands for "no bone" in a table of bone indices: that share of the weight follows the mesh object itself.
inline constexpr Index no_bone = -1;

/// Vertices whose weights sum to no more than this are not moved by an armature.
inline constexpr double least_total_weight = 1e-4F;

/// How vertices hang on bones.
struct BoneWeights {
  /// (n,k) bones, in the order in which Blender stores a vertex's groups; `no_bone` or any number where the weight is 0.
  ConstIndexTable indices;
  /// (n,k) weights as painted, 0 or more, not normalised.
  ConstValues weights;
};

/// One pose of the bones, see the formulas above.
struct PosedBones {
  /// (b,16) from object space at rest to object space posed.
  ConstMatrices4 matrices;
  /// (b,16) from a bone's own axes to the armature's space, at rest. Only dual quaternions use them: they take a bone's rotation
  /// from its posed axes, Y first. No rows: as if all bones lay along the armature's axes, which is the same wherever no bone is
  /// sheared or scaled unevenly.
  ConstMatrices4 rest_matrices;
  /// From the armature's space to the mesh's object space. Only dual quaternions use it: they blend in the armature's space, which
  /// is another blend wherever one of the two objects is scaled unevenly.
  Eigen::Matrix4d armature = Eigen::Matrix4d::Identity();
};

/// @brief Moves vertices as the bones do.
/// @param rest_positions (n,3) object space
/// @param weights (n,k) table
/// @param bones their pose
/// @param skinning which blend
/// @return (n,3) object space
/// @throws InvalidInput on arrays that do not fit each other, numbers that are not finite, negative weights, indices without a
/// bone,
///   matrices that are not affine, rest matrices that are no rotations and a singular armature matrix
Positions pose_vertices(ConstPositions rest_positions, const BoneWeights& weights, const PosedBones& bones, Skinning skinning);

/// @brief Derivative of every vertex's posed position by its rest position.
/// @param vertex_count n, checked against the weights
/// @return (n,9), row by row
/// @throws InvalidInput as `pose_vertices`
Matrices3 skinning_jacobians(Eigen::Index vertex_count, const BoneWeights& weights, const PosedBones& bones, Skinning skinning);

}  // namespace followthrough
