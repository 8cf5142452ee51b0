// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/surface_queries.hpp"

#include <cmath>
#include <limits>

#include "followthrough/errors.hpp"
#include "triangle_tree.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

void require_surface(ConstPositions points, ConstPositions vertices, ConstTriangles triangles) {
  require_finite("points", points);
  require_finite("vertices", vertices);
  require_indices("triangles", triangles, vertices.rows());
}

}  // namespace

ClosestPoints closest_points(ConstPositions points, ConstPositions vertices, ConstTriangles triangles) {
  require_surface(points, vertices, triangles);
  if (triangles.rows() == 0) throw InvalidInput("triangles", "is empty, expected at least one triangle");
  const TriangleTree tree(vertices, triangles);
  ClosestPoints result;
  result.triangles.resize(points.rows());
  result.barycentric.resize(points.rows(), 3);
  result.distances.resize(points.rows());
#pragma omp parallel for schedule(dynamic, 256) num_threads(worthwhile_threads(points.rows(), 1'000))
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    const ClosestPoint closest = tree.closest(points.row(p));
    result.triangles[p] = closest.triangle;
    result.barycentric.row(p) = closest.barycentric;
    result.distances[p] = std::sqrt(closest.squared_distance);
  }
  return result;
}

Vector winding_numbers(ConstPositions points, ConstPositions vertices, ConstTriangles triangles) {
  require_surface(points, vertices, triangles);
  const TriangleTree tree(vertices, triangles);
  Vector result(points.rows());
#pragma omp parallel for schedule(dynamic, 16) num_threads(worthwhile_threads(points.rows() * triangles.rows(), 40))
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    result[p] = tree.winding_number(points.row(p), std::numeric_limits<double>::infinity());
  }
  return result;
}

}  // namespace followthrough
