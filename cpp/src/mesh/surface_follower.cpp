// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/mesh/surface_follower.hpp"

#include <cmath>
#include <vector>

#include <Eigen/Dense>

#include "boundary_anchors.hpp"
#include "followthrough/errors.hpp"
#include "laplacian.hpp"

namespace followthrough {
namespace {

// Two edges and the unit normal. False where the triangle has no area to speak of.
bool triangle_frame(ConstPositions vertices, const Triangles& triangles, Eigen::Index t, Eigen::Matrix3d& frame) {
  const Eigen::Vector3d a = vertices.row(triangles(t, 0));
  const Eigen::Vector3d ab = Eigen::Vector3d(vertices.row(triangles(t, 1))) - a,
                        ac = Eigen::Vector3d(vertices.row(triangles(t, 2))) - a;
  const Eigen::Vector3d normal = ab.cross(ac);
  const double area = normal.norm();
  if (!(area > 1e-9 * std::max(ab.squaredNorm(), ac.squaredNorm()))) return false;
  frame << ab, ac, normal / area;
  return true;
}

}  // namespace

struct SurfaceFollower::State {
  Positions rest;
  Triangles triangles;
  std::vector<ClosestPoint> anchors;
  std::vector<Eigen::Vector3d> offsets;         // from the closest point to the vertex, at rest
  std::vector<Eigen::Matrix3d> inverse_frames;  // at rest, one a triangle
  Vector areas;                                 // weight of each triangle in its corners' deformation; 0: no frame
  LaplaceSolver solver;
};

SurfaceFollower::SurfaceFollower(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets,
                                 ConstIndices own_offsets, ConstIndices own_triangles) {
  require_surface_and_tets(surface_vertices, triangles, vertices, tets);
  LaplaceSolver solver(vertices, tets, boundary_vertices(tets, vertices.rows()), Stencil::kLinear);
  std::vector<ClosestPoint> anchors =
      boundary_anchors(surface_vertices, triangles, vertices, solver.given(), own_offsets, own_triangles);
  state_ = std::make_unique<State>(State{surface_vertices, triangles, std::move(anchors), {}, {}, {}, std::move(solver)});
  std::size_t k = 0;
  state_->offsets.resize(state_->anchors.size());
  for (Eigen::Index v = 0; v < vertices.rows(); ++v) {
    if (!state_->solver.given()[v]) continue;
    const ClosestPoint& anchor = state_->anchors[k];
    Eigen::Vector3d offset = vertices.row(v);
    for (int corner = 0; corner < 3; ++corner) {
      offset -= anchor.barycentric[corner] * surface_vertices.row(triangles(anchor.triangle, corner)).transpose();
    }
    state_->offsets[k++] = offset;
  }
  state_->areas = Vector::Zero(triangles.rows());
  state_->inverse_frames.assign(static_cast<std::size_t>(triangles.rows()), Eigen::Matrix3d::Zero());
  for (Eigen::Index t = 0; t < triangles.rows(); ++t) {
    Eigen::Matrix3d frame;
    if (!triangle_frame(state_->rest, state_->triangles, t, frame)) continue;
    state_->areas[t] = frame.col(0).cross(frame.col(1)).norm();
    state_->inverse_frames[static_cast<std::size_t>(t)] = frame.inverse();
  }
}

SurfaceFollower::~SurfaceFollower() = default;
SurfaceFollower::SurfaceFollower(SurfaceFollower&&) noexcept = default;
SurfaceFollower& SurfaceFollower::operator=(SurfaceFollower&&) noexcept = default;

Positions SurfaceFollower::operator()(ConstPositions positions) const {
  const State& s = *state_;
  require_rows("positions", positions.rows(), s.rest.rows());
  require_finite("positions", positions);
  // Deformation at each vertex of the surface: the mean of its triangles', which turns and stretches with them but keeps normals'
  // length.
  std::vector<Eigen::Matrix3d> deformations(static_cast<std::size_t>(s.rest.rows()), Eigen::Matrix3d::Zero());
  std::vector<double> weights(deformations.size(), 0);
  Eigen::Matrix3d overall = Eigen::Matrix3d::Zero();
  double total = 0;
  for (Eigen::Index t = 0; t < s.triangles.rows(); ++t) {
    Eigen::Matrix3d frame;
    if (s.areas[t] == 0 || !triangle_frame(positions, s.triangles, t, frame)) continue;
    const Eigen::Matrix3d deformation = s.areas[t] * frame * s.inverse_frames[static_cast<std::size_t>(t)];
    overall += deformation;
    total += s.areas[t];
    for (int corner = 0; corner < 3; ++corner) {
      const auto v = static_cast<std::size_t>(s.triangles(t, corner));
      deformations[v] += deformation;
      weights[v] += s.areas[t];
    }
  }
  if (total > 0) {
    overall /= total;
  } else {
    overall.setIdentity();
  }
  for (std::size_t v = 0; v < deformations.size(); ++v) {
    deformations[v] = weights[v] > 0 ? Eigen::Matrix3d(deformations[v] / weights[v]) : overall;
  }

  Values result(s.solver.given().size(), 3);
  std::size_t k = 0;
  for (Eigen::Index v = 0; v < result.rows(); ++v) {
    if (!s.solver.given()[v]) continue;
    const ClosestPoint& anchor = s.anchors[k];
    Eigen::Vector3d position = Eigen::Vector3d::Zero();
    for (int corner = 0; corner < 3; ++corner) {
      const Index on = s.triangles(anchor.triangle, corner);
      position +=
          anchor.barycentric[corner] * (positions.row(on).transpose() + deformations[static_cast<std::size_t>(on)] * s.offsets[k]);
    }
    result.row(v) = position;
    ++k;
  }
  s.solver.solve(result);
  return result;
}

}  // namespace followthrough
