// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/embedding.hpp"

#include <vector>

#include "box_tree.hpp"
#include "followthrough/errors.hpp"
#include "tet_weights.hpp"
#include "triangle_tree.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

constexpr double kInside = -1e-12;  // smallest weight of a point that counts as inside

TetCorners corners_of(ConstPositions vertices, ConstTets tets, Eigen::Index tet) {
  return {vertices.row(tets(tet, 0)), vertices.row(tets(tet, 1)), vertices.row(tets(tet, 2)), vertices.row(tets(tet, 3))};
}

double squared_distance(const Eigen::Vector3d& p, const TetCorners& x) {
  if (tet_weights(p, x).minCoeff() >= 0) return 0;
  double best = closest_on_triangle(p, x[0], x[1], x[2]).squared_distance;
  best = std::min(best, closest_on_triangle(p, x[0], x[1], x[3]).squared_distance);
  best = std::min(best, closest_on_triangle(p, x[0], x[2], x[3]).squared_distance);
  return std::min(best, closest_on_triangle(p, x[1], x[2], x[3]).squared_distance);
}

}  // namespace

Embedding embed(ConstPositions points, ConstPositions vertices, ConstTets tets) {
  require_finite("points", points);
  require_finite("vertices", vertices);
  require_indices("tets", tets, vertices.rows());
  std::vector<Index> solid;
  std::vector<Box> boxes;
  double size = 0;
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    const TetCorners x = corners_of(vertices, tets, t);
    if (!tet_is_solid(x)) continue;
    Box box;
    for (const auto& corner : x) box.extend(corner);
    size = std::max(size, box.sizes().maxCoeff());
    solid.push_back(static_cast<Index>(t));
    boxes.push_back(box);
  }
  if (solid.empty()) throw InvalidInput("tets", "found none with a volume, expected at least one");
  const BoxTree tree(boxes);

  Embedding embedding;
  embedding.tets.resize(points.rows());
  embedding.weights.resize(points.rows(), 4);
#pragma omp parallel for schedule(dynamic, 256) num_threads(worthwhile_threads(points.rows(), 600))
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    const Eigen::Vector3d point = points.row(p);
    const Eigen::Vector3d margin = Eigen::Vector3d::Constant(1e-12 * size);
    Index best = static_cast<Index>(solid.size());
    tree.overlapping(Box(point - margin, point + margin), [&](Index item) {
      if (item < best &&
          tet_weights(point, corners_of(vertices, tets, solid[static_cast<std::size_t>(item)])).minCoeff() >= kInside)
        best = item;
    });
    if (best == static_cast<Index>(solid.size())) {
      best = tree.nearest(point, [&](Index item) {
        return squared_distance(point, corners_of(vertices, tets, solid[static_cast<std::size_t>(item)]));
      });
    }
    embedding.tets[p] = solid[static_cast<std::size_t>(best)];
    embedding.weights.row(p) = tet_weights(point, corners_of(vertices, tets, embedding.tets[p]));
  }
  return embedding;
}

Values interpolate(ConstValues values, ConstTets tets, ConstIndices embedding_tets, ConstWeights4 embedding_weights) {
  require_indices("tets", tets, values.rows());
  require_indices("embedding_tets", embedding_tets, tets.rows());
  require_rows("embedding_weights", embedding_weights.rows(), embedding_tets.rows());
  Values result(embedding_tets.rows(), values.cols());
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(result.size(), 4))
  for (Eigen::Index p = 0; p < embedding_tets.rows(); ++p) {
    const auto tet = tets.row(embedding_tets[p]);
    result.row(p) = embedding_weights(p, 0) * values.row(tet[0]) + embedding_weights(p, 1) * values.row(tet[1]) +
                    embedding_weights(p, 2) * values.row(tet[2]) + embedding_weights(p, 3) * values.row(tet[3]);
  }
  return result;
}

}  // namespace followthrough
