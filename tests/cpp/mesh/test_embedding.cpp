// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <random>

#include "followthrough/errors.hpp"
#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/surface_queries.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "shapes.hpp"

using namespace followthrough;

namespace {

Positions random_points(Eigen::Index count, double spread, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> place(-spread, spread);
  return Positions::NullaryExpr(count, 3, [&]() { return place(random); });
}

}  // namespace

TEST_CASE("affine motions of the tets carry points inside and outside by the same motion") {
  const shapes::Shape sphere = shapes::sphere(20, 40);
  const TetVolume volume = tetrahedralize(sphere.vertices, sphere.triangles, {8, 0, false});
  const Positions points = random_points(500, 1.5, 1);
  const Embedding embedding = embed(points, volume.vertices, volume.tets);
  Eigen::Matrix3d linear;
  linear << 1.1, 0.2, -0.4, 0.3, 0.8, 0.5, -0.2, 0.1, 1.4;
  const Eigen::RowVector3d shift(0.3, -2, 1);
  const Positions moved = (volume.vertices * linear).rowwise() + shift;
  const Positions carried = interpolate(moved, volume.tets, embedding.tets, embedding.weights);
  CHECK((carried - Positions((points * linear).rowwise() + shift)).cwiseAbs().maxCoeff() < 1e-12);
  CHECK((embedding.weights.rowwise().sum().array() - 1).abs().maxCoeff() < 1e-14);
}

TEST_CASE("a point inside a tet gets that tet, one outside the nearest") {
  const shapes::Shape cube = shapes::cube();
  const TetVolume volume = tetrahedralize(cube.vertices, cube.triangles, {4, 0, false});
  const Positions points = random_points(400, 1.2, 2);
  const Embedding embedding = embed(points, volume.vertices, volume.tets);
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    const bool inside = points.row(p).minCoeff() >= 0 && points.row(p).maxCoeff() <= 1;
    if (inside) {
      CHECK(embedding.weights.row(p).minCoeff() >= -1e-12);
      continue;
    }
    // The closest point of the cube lies in the chosen tet.
    const Positions nearest = points.row(p).cwiseMax(0).cwiseMin(1);
    Positions corners(4, 3);
    for (int k = 0; k < 4; ++k) corners.row(k) = volume.vertices.row(volume.tets(embedding.tets[p], k));
    Tets one(1, 4);
    one << 0, 1, 2, 3;
    CHECK(embed(nearest, corners, one).weights.minCoeff() > -1e-9);
  }
}

TEST_CASE("the embedding made with the voxels is as good as the general search") {
  const shapes::Shape sphere = shapes::sphere(20, 40);
  const TetVolume volume = tetrahedralize(sphere.vertices, sphere.triangles, {8, 0, false});
  const Embedding searched = embed(sphere.vertices, volume.vertices, volume.tets);
  CHECK((interpolate(volume.vertices, volume.tets, searched.tets, searched.weights) - sphere.vertices).cwiseAbs().maxCoeff() <
        1e-13);
}

TEST_CASE("closest points agree with looking at every triangle") {
  const shapes::Shape shape = shapes::horseshoe(0.5, 0.1, 30, 12);
  const Positions points = random_points(200, 2, 3);
  const ClosestPoints closest = closest_points(points, shape.vertices, shape.triangles);
  for (Eigen::Index p = 0; p < points.rows(); ++p) {
    double best = 1e300;
    for (Eigen::Index t = 0; t < shape.triangles.rows(); ++t) {
      best = std::min(best, closest_points(points.row(p), shape.vertices, shape.triangles.row(t)).distances[0]);
    }
    CHECK(closest.distances[p] == doctest::Approx(best));
    Eigen::RowVector3d place = Eigen::RowVector3d::Zero();
    for (int k = 0; k < 3; ++k) place += closest.barycentric(p, k) * shape.vertices.row(shape.triangles(closest.triangles[p], k));
    CHECK((place - points.row(p)).norm() == doctest::Approx(closest.distances[p]));
    CHECK(closest.barycentric.row(p).minCoeff() >= 0);
    CHECK(closest.barycentric.row(p).sum() == doctest::Approx(1));
  }
}

TEST_CASE("winding numbers count how often a surface goes around") {
  const shapes::Shape sphere = shapes::sphere(20, 40);
  Positions points(3, 3);
  points << 0, 0, 0, 0.5, 0.2, -0.3, 2, 0, 0;
  CHECK(winding_numbers(points, sphere.vertices, sphere.triangles).isApprox(Eigen::Vector3d(1, 1, 0), 1e-12));
  const shapes::Shape twice = shapes::together(sphere, sphere);
  CHECK(winding_numbers(points, twice.vertices, twice.triangles).isApprox(Eigen::Vector3d(2, 2, 0), 1e-12));
  const shapes::Shape out = shapes::inside_out(sphere);
  CHECK(winding_numbers(points, out.vertices, out.triangles).isApprox(Eigen::Vector3d(-1, -1, 0), 1e-12));
  // Half a closed surface goes around its middle half a time.
  Triangles half(0, 3);
  for (Eigen::Index t = 0; t < sphere.triangles.rows(); ++t) {
    double height = 0;
    for (int k = 0; k < 3; ++k) height += sphere.vertices(sphere.triangles(t, k), 0);
    if (height < 0) continue;
    half.conservativeResize(half.rows() + 1, 3);
    half.bottomRows(1) = sphere.triangles.row(t);
  }
  CHECK(winding_numbers(points.topRows(1), sphere.vertices, half)[0] == doctest::Approx(0.5).epsilon(0.05));
}

TEST_CASE("bad arrays are refused by name") {
  const shapes::Shape cube = shapes::cube();
  const TetVolume volume = tetrahedralize(cube.vertices, cube.triangles, {2, 0, false});
  Tets bad = volume.tets;
  bad(0, 0) = 1000;
  CHECK_THROWS_AS(embed(cube.vertices, volume.vertices, bad), InvalidInput);
  CHECK_THROWS_AS(embed(cube.vertices, Positions::Zero(volume.vertices.rows(), 3), volume.tets), InvalidInput);
  CHECK_THROWS_AS(interpolate(volume.vertices, volume.tets, Indices::Constant(3, 1000), Weights4::Zero(3, 4)), InvalidInput);
  CHECK_THROWS_AS(interpolate(volume.vertices, volume.tets, Indices::Zero(3), Weights4::Zero(2, 4)), InvalidInput);
  CHECK_THROWS_AS(closest_points(cube.vertices, cube.vertices, Triangles(0, 3)), InvalidInput);
}
