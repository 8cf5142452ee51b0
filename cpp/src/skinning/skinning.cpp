// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/skinning/skinning.hpp"

#include "followthrough/errors.hpp"
#include "skinning/bone_blend.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {

Positions pose_vertices(ConstPositions rest_positions, const BoneWeights& weights, const PosedBones& bones, Skinning skinning) {
  const BoneBlend blend(weights, bones, skinning);
  require_rows("bone_weights", blend.vertex_count(), rest_positions.rows());
  Positions posed(rest_positions.rows(), 3);
  int unusable = 0;
  const int threads = worthwhile_threads(posed.rows(), blend.nanoseconds());
#pragma omp parallel for schedule(static) reduction(| : unusable) num_threads(threads)
  for (Eigen::Index vertex = 0; vertex < rest_positions.rows(); ++vertex) {
    bool valid = true;
    const VertexTransform transform = blend.vertex_transform(vertex, valid);
    posed.row(vertex) = (transform.linear * rest_positions.row(vertex).transpose() + transform.translation).transpose();
    unusable |= !valid || !posed.row(vertex).allFinite();
  }
  if (unusable) {
    blend.require_weights();
    require_finite("rest_positions", rest_positions);
    throw InvalidInput("bone_matrices", "the numbers are so large that posed positions overflow");
  }
  return posed;
}

Matrices3 skinning_jacobians(Eigen::Index vertex_count, const BoneWeights& weights, const PosedBones& bones, Skinning skinning) {
  const BoneBlend blend(weights, bones, skinning);
  require_rows("bone_weights", blend.vertex_count(), vertex_count);
  Matrices3 jacobians(vertex_count, 9);
  int unusable = 0;
  const int threads = worthwhile_threads(vertex_count, blend.nanoseconds());
#pragma omp parallel for schedule(static) reduction(| : unusable) num_threads(threads)
  for (Eigen::Index vertex = 0; vertex < vertex_count; ++vertex) {
    bool valid = true;
    Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(jacobians.row(vertex).data()) =
        blend.vertex_transform(vertex, valid).linear;
    unusable |= !valid;
  }
  if (unusable) blend.require_weights();
  return jacobians;
}

}  // namespace followthrough
