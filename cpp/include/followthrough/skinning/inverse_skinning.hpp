// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Inverse skinning: what to add to the rest positions so that skinning shows a wanted displacement of the posed ones.
#pragma once

#include "followthrough/skinning/skinning.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

/// Result of inverse skinning.
struct InverseSkinning {
  Positions offsets;    ///< (n,3) to add to the rest positions, object space
  Positions residuals;  ///< (n,3) displacement - J offset: what no bounded offset can show, object space
};

/// @brief Solves J offset = displacement for every vertex.
///
/// Singular values of J below `minimum_stretch` are raised to it, so no offset is longer than displacement / minimum_stretch; where
/// none is, the residual is zero up to rounding.
/// @param jacobians (n,9) 3x3 matrices, row by row
/// @param displacements (n,3) object space
/// @param minimum_stretch more than 0
/// @throws InvalidInput on arrays that do not fit each other and numbers that are not finite
InverseSkinning invert_displacements(ConstMatrices3 jacobians, ConstPositions displacements, double minimum_stretch);

/// @brief The same with the Jacobians of skinning, in one pass.
///
/// Skinning is affine in a vertex's rest position, so pose(rest + offset) = pose(rest) + displacement - residual holds exactly.
/// @param weights, bones, skinning as in `pose_vertices`
/// @param displacements (n,3) object space
/// @param minimum_stretch more than 0
/// @throws InvalidInput as `pose_vertices`
InverseSkinning inverse_skin(const BoneWeights& weights, const PosedBones& bones, ConstPositions displacements, Skinning skinning,
                             double minimum_stretch);

}  // namespace followthrough
