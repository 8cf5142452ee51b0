// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/surface_transfer.hpp"

#include <vector>

#include "boundary_anchors.hpp"
#include "followthrough/errors.hpp"
#include "laplacian.hpp"

namespace followthrough {

struct SurfaceTransfer::State {
  Eigen::Index surface_count;
  Triangles triangles;
  std::vector<ClosestPoint> anchors;
  LaplaceSolver solver;
};

SurfaceTransfer::SurfaceTransfer(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets,
                                 ConstIndices own_offsets, ConstIndices own_triangles) {
  require_surface_and_tets(surface_vertices, triangles, vertices, tets);
  LaplaceSolver solver(vertices, tets, boundary_vertices(tets, vertices.rows()), Stencil::kNonnegative);
  std::vector<ClosestPoint> anchors =
      boundary_anchors(surface_vertices, triangles, vertices, solver.given(), own_offsets, own_triangles);
  state_ = std::make_unique<State>(State{surface_vertices.rows(), triangles, std::move(anchors), std::move(solver)});
}

SurfaceTransfer::~SurfaceTransfer() = default;
SurfaceTransfer::SurfaceTransfer(SurfaceTransfer&&) noexcept = default;
SurfaceTransfer& SurfaceTransfer::operator=(SurfaceTransfer&&) noexcept = default;

Values SurfaceTransfer::operator()(ConstValues values) const {
  require_rows("values", values.rows(), state_->surface_count);
  require_finite("values", values);
  const Mask& given = state_->solver.given();
  Values result = Values::Zero(given.size(), values.cols());
  if (values.cols() == 0) return result;
  std::size_t k = 0;
  for (Eigen::Index v = 0; v < given.size(); ++v) {
    if (!given[v]) continue;
    const ClosestPoint& anchor = state_->anchors[k++];
    for (int corner = 0; corner < 3; ++corner) {
      result.row(v) += anchor.barycentric[corner] * values.row(state_->triangles(anchor.triangle, corner));
    }
  }
  state_->solver.solve(result);
  // The maximum principle holds up to rounding; hold it exactly.
  const Eigen::RowVectorXd least = values.colwise().minCoeff(), most = values.colwise().maxCoeff();
  for (Eigen::Index v = 0; v < result.rows(); ++v) result.row(v) = result.row(v).cwiseMax(least).cwiseMin(most);
  return result;
}

}  // namespace followthrough
