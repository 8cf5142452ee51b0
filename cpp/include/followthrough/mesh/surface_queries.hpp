// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Closest points and winding numbers of a triangle surface.
#pragma once

#include "followthrough/types.hpp"

namespace followthrough {

struct ClosestPoints {
  Indices triangles;      ///< (p,) the triangle that holds each closest point; of equally near ones the first
  Positions barycentric;  ///< (p,3) its weights there, 0 or more, summing to one
  Vector distances;       ///< (p,) m
};

/// @param points (p,3) m
/// @param vertices (v,3) m
/// @param triangles (t,3), one at least
/// @throws InvalidInput on an empty surface, non-finite positions or an index out of range
ClosestPoints closest_points(ConstPositions points, ConstPositions vertices, ConstTriangles triangles);

/// @brief Generalized winding numbers [Jacobson et al. 2013]: how often the surface, as its faces are turned, goes around each
/// point. Exact: the solid angles of all triangles, at a cost of points times triangles.
/// @param points (p,3) m
/// @param vertices (v,3) m
/// @param triangles (t,3)
/// @return (p,) 1 inside a closed surface whose faces look outside, 0 outside, between them near holes
/// @throws InvalidInput on non-finite positions or an index out of range
Vector winding_numbers(ConstPositions points, ConstPositions vertices, ConstTriangles triangles);

}  // namespace followthrough
