// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/skinning/inverse_skinning.hpp"

#include <cmath>
#include <string>

#include "followthrough/errors.hpp"
#include "skinning/bone_blend.hpp"
#include "skinning/stretch_solve.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

void require_minimum_stretch(double minimum_stretch) {
  if (!(std::isfinite(minimum_stretch) && minimum_stretch > 0.0)) {
    throw InvalidInput("minimum_stretch", "found " + std::to_string(minimum_stretch) + ", expected a finite number above 0");
  }
}

/// Writes one vertex; false where the result is not finite.
bool solve_vertex(const Matrix3d& jacobian, Eigen::Index vertex, ConstPositions displacements, double minimum_stretch,
                  InverseSkinning& result) {
  const Vector3d displacement = displacements.row(vertex);
  if (!displacement.allFinite() || !jacobian.allFinite()) return false;
  const Vector3d offset = stretch_solve(jacobian, displacement, minimum_stretch);
  result.offsets.row(vertex) = offset;
  result.residuals.row(vertex) = displacement - jacobian * offset;
  return result.residuals.row(vertex).allFinite();
}

InverseSkinning make_result(Eigen::Index vertices) { return {Positions(vertices, 3), Positions(vertices, 3)}; }

}  // namespace

InverseSkinning invert_displacements(ConstMatrices3 jacobians, ConstPositions displacements, double minimum_stretch) {
  require_minimum_stretch(minimum_stretch);
  require_rows("jacobians", jacobians.rows(), displacements.rows());
  InverseSkinning result = make_result(displacements.rows());
  int unusable = 0;
  const int threads = worthwhile_threads(displacements.rows(), stretch_solve_nanoseconds);
#pragma omp parallel for schedule(static) reduction(| : unusable) num_threads(threads)
  for (Eigen::Index vertex = 0; vertex < displacements.rows(); ++vertex) {
    const Matrix3d jacobian = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(jacobians.row(vertex).data());
    unusable |= !solve_vertex(jacobian, vertex, displacements, minimum_stretch, result);
  }
  if (unusable) {
    require_finite("jacobians", jacobians);
    require_finite("displacements", displacements);
    throw InvalidInput("displacements", "the numbers are so large that offsets overflow");
  }
  return result;
}

InverseSkinning inverse_skin(const BoneWeights& weights, const PosedBones& bones, ConstPositions displacements, Skinning skinning,
                             double minimum_stretch) {
  require_minimum_stretch(minimum_stretch);
  const BoneBlend blend(weights, bones, skinning);
  require_rows("displacements", displacements.rows(), blend.vertex_count());
  InverseSkinning result = make_result(displacements.rows());
  int unusable = 0;
  const int threads = worthwhile_threads(displacements.rows(), blend.nanoseconds() + stretch_solve_nanoseconds);
#pragma omp parallel for schedule(static) reduction(| : unusable) num_threads(threads)
  for (Eigen::Index vertex = 0; vertex < displacements.rows(); ++vertex) {
    bool valid = true;
    const VertexTransform transform = blend.vertex_transform(vertex, valid);
    unusable |= !valid || !solve_vertex(transform.linear, vertex, displacements, minimum_stretch, result);
  }
  if (unusable) {
    blend.require_weights();
    require_finite("displacements", displacements);
    throw InvalidInput("displacements", "the numbers are so large that offsets overflow");
  }
  return result;
}

}  // namespace followthrough
