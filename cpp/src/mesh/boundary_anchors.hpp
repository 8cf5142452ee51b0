// SPDX-License-Identifier: GPL-3.0-or-later
// Where each boundary vertex of a volume hangs on the surface.
#pragma once

#include <vector>

#include "followthrough/types.hpp"
#include "triangle_tree.hpp"

namespace followthrough {

/// @brief Closest points of the surface for the vertices that `wanted` names, in their own part where the volume was split.
/// @return one a wanted vertex, in ascending order of the vertices
/// @throws InvalidInput on empty or non-finite arrays, an index out of range, or offsets that do not fit
std::vector<ClosestPoint> boundary_anchors(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices,
                                           const Mask& wanted, ConstIndices own_offsets, ConstIndices own_triangles);

/// @throws InvalidInput where the arrays of a surface and a tet mesh cannot be used together
void require_surface_and_tets(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets);

}  // namespace followthrough
