// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <random>

#include "followthrough/errors.hpp"
#include "followthrough/mesh/surface_follower.hpp"
#include "followthrough/mesh/surface_transfer.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "shapes.hpp"

using namespace followthrough;

namespace {

struct Case {
  shapes::Shape shape = shapes::sphere(30, 60);
  TetVolume volume = tetrahedralize(shape.vertices, shape.triangles, {10, 0, false});

  SurfaceTransfer transfer() const {
    return {shape.vertices, shape.triangles, volume.vertices, volume.tets, volume.own_offsets, volume.own_triangles};
  }
  SurfaceFollower follower() const {
    return {shape.vertices, shape.triangles, volume.vertices, volume.tets, volume.own_offsets, volume.own_triangles};
  }
};

}  // namespace

TEST_CASE("transferred values stay in range, and weights stay weights") {
  const Case c;
  std::mt19937 random(5);
  std::uniform_real_distribution<double> place(0, 1);
  Values weights =
      Values::NullaryExpr(c.shape.vertices.rows(), 5, [&]() { return place(random) < 0.6 ? 0.0 : place(random) + 1e-9; });
  weights.col(0).array() += 0.1;
  weights = Values(weights.array().colwise() / weights.rowwise().sum().array());
  const Values carried = c.transfer()(weights);
  CHECK(carried.rows() == c.volume.vertices.rows());
  CHECK(carried.minCoeff() >= 0);
  CHECK(carried.maxCoeff() <= weights.maxCoeff());
  CHECK((carried.rowwise().sum().array() - 1).abs().maxCoeff() < 1e-12);
  CHECK(c.transfer()(Values::Constant(weights.rows(), 1, 0.3)).isApproxToConstant(0.3, 1e-13));
}

TEST_CASE("weights stay weights in badly shaped tets, too") {
  Case c;
  Eigen::Matrix3d shear;
  shear << 1, 0.9, 0, 0, 1, 0, 0.8, 0, 0.15;
  c.shape.vertices = Positions(c.shape.vertices * shear);
  c.volume.vertices = Positions(c.volume.vertices * shear);
  Values weights = Values::Zero(c.shape.vertices.rows(), 8);
  for (Eigen::Index v = 0; v < weights.rows(); ++v) weights(v, v * 7919 % 8) = 1;
  const Values carried = c.transfer()(weights);
  CHECK(carried.minCoeff() >= 0);
  CHECK((carried.rowwise().sum().array() - 1).abs().maxCoeff() < 1e-12);
}

TEST_CASE("inside, values are harmonic: nearly linear where the surface's are") {
  const Case c;
  const Values carried = c.transfer()(c.shape.vertices);
  for (Eigen::Index v = 0; v < carried.rows(); ++v) {
    const double radius = c.volume.vertices.row(v).norm();
    // The boundary is a staircase of about a cell around the sphere.
    if (radius < 0.5) CHECK((carried.row(v) - c.volume.vertices.row(v)).norm() < 0.1);
    if (radius > 1) CHECK(carried.row(v).isApprox(c.volume.vertices.row(v) / radius, 5e-2));
  }
  // A step on the surface is smooth inside, halfway in the middle.
  Values step = (c.shape.vertices.col(0).array() > 1e-9).cast<double>().matrix();
  const Values smooth = c.transfer()(step);
  for (Eigen::Index v = 0; v < carried.rows(); ++v) {
    if (c.volume.vertices.row(v).norm() < 1e-9) CHECK(smooth(v, 0) == doctest::Approx(0.5).epsilon(0.1));
  }
}

TEST_CASE("a rigid motion of the surface moves the volume rigidly") {
  const Case c;
  const SurfaceFollower follower = c.follower();
  CHECK((follower(c.shape.vertices) - c.volume.vertices).cwiseAbs().maxCoeff() < 1e-10);
  const Eigen::Matrix3d turn = Eigen::AngleAxisd(2.3, Eigen::Vector3d(1, -2, 0.5).normalized()).toRotationMatrix();
  const Eigen::RowVector3d shift(10, -3, 4);
  const Positions moved = (c.shape.vertices * turn.transpose()).rowwise() + shift;
  const Positions expected = (c.volume.vertices * turn.transpose()).rowwise() + shift;
  CHECK((follower(moved) - expected).cwiseAbs().maxCoeff() < 1e-10);
}

TEST_CASE("a bent surface takes the volume with it") {
  const Case c;
  Positions bent = c.shape.vertices;
  bent.col(2) += 0.3 * c.shape.vertices.col(0).array().square().matrix();
  const Positions followed = c.follower()(bent);
  for (Eigen::Index v = 0; v < followed.rows(); ++v) {
    const Eigen::RowVector3d rest = c.volume.vertices.row(v);
    const Eigen::RowVector3d expected = rest + Eigen::RowVector3d(0, 0, 0.3 * rest[0] * rest[0]);
    CHECK((followed.row(v) - expected).norm() < 0.2);
  }
}

TEST_CASE("degenerate triangles and several pieces do not stop either") {
  shapes::Shape shape = shapes::together(shapes::sphere(12, 24), shapes::moved(shapes::cube(), {3, 0, 0}));
  shape.triangles.conservativeResize(shape.triangles.rows() + 1, 3);
  shape.triangles.bottomRows(1) << 3, 3, 4;
  const TetVolume volume = tetrahedralize(shape.vertices, shape.triangles, {12, 0, true});
  const SurfaceTransfer transfer(shape.vertices, shape.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                 volume.own_triangles);
  CHECK(transfer(Values::Ones(shape.vertices.rows(), 2)).isApproxToConstant(1));
  const SurfaceFollower follower(shape.vertices, shape.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                 volume.own_triangles);
  CHECK((follower(shape.vertices) - volume.vertices).cwiseAbs().maxCoeff() < 1e-10);
}

TEST_CASE("wrong lengths and non-finite values are refused") {
  const Case c;
  CHECK_THROWS_AS(c.transfer()(Values::Ones(3, 1)), InvalidInput);
  CHECK_THROWS_AS(c.transfer()(Values::Constant(c.shape.vertices.rows(), 1, std::nan(""))), InvalidInput);
  CHECK_THROWS_AS(c.follower()(Positions::Zero(3, 3)), InvalidInput);
  CHECK_THROWS_AS(
      SurfaceTransfer(c.shape.vertices, c.shape.triangles, c.volume.vertices, c.volume.tets, Indices::Zero(3), Indices(0)),
      InvalidInput);
}
