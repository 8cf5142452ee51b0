// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Points carried by a tet mesh: found once at rest, then moved with the tets by barycentric weights.
#pragma once

#include "followthrough/types.hpp"

namespace followthrough {

struct Embedding {
  Indices tets;      ///< (p,) the tet that carries each point
  Weights4 weights;  ///< (p,4) barycentric weights, summing to one
};

/// @brief Finds the tet that holds each point. A point outside all of them goes to the nearest one, with weights below 0 or above
/// 1, so that an affine motion of the mesh moves every point by the same affine motion.
///
/// Of several tets that hold a point (or are equally near) the first counts, so coincident points are carried alike.
///
/// @param points (p,3) m
/// @param vertices (n,3) m, at rest
/// @param tets (m,4)
/// @throws InvalidInput on non-finite positions, an index out of range, or where no tet has a volume
Embedding embed(ConstPositions points, ConstPositions vertices, ConstTets tets);

/// @brief Values at embedded points: the weighted sum over the tet's four corners.
/// @param values (n,k) values on the tet mesh's vertices
/// @param tets (m,4)
/// @param embedding_tets (p,)
/// @param embedding_weights (p,4)
/// @return (p,k)
/// @throws InvalidInput on indices out of range or lengths that do not fit
Values interpolate(ConstValues values, ConstTets tets, ConstIndices embedding_tets, ConstWeights4 embedding_weights);

}  // namespace followthrough
