// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>
#include <omp.h>

#include <Eigen/Dense>
#include <algorithm>
#include <random>
#include <vector>

#include "followthrough/errors.hpp"
#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "shapes.hpp"

using namespace followthrough;

namespace {

TetVolume voxel(const shapes::Shape& shape, Index cells, bool split = false) {
  return tetrahedralize(shape.vertices, shape.triangles, {cells, 0, split});
}

int parts(const TetVolume& volume) { return connected_parts(volume.tets, volume.vertices.rows()).maxCoeff() + 1; }

double tet_volume(const TetVolume& volume, Eigen::Index t) {
  Eigen::Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.row(k) = volume.vertices.row(volume.tets(t, k + 1)) - volume.vertices.row(volume.tets(t, 0));
  return edges.determinant() / 6;
}

bool same(const TetVolume& a, const TetVolume& b) {
  return a.vertices == b.vertices && a.tets == b.tets && a.embedding_tets == b.embedding_tets &&
         a.embedding_weights == b.embedding_weights;
}

Eigen::Matrix3d some_rotation(unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  return Eigen::Quaterniond(normal(random), normal(random), normal(random), normal(random)).normalized().toRotationMatrix();
}

}  // namespace

TEST_CASE("a fine sphere of radius 1 gives the cubes of 0.2 that meet the ball, however it is tessellated") {
  Index expected = 0;
  for (int x = -5; x < 5; ++x) {
    for (int y = -5; y < 5; ++y) {
      for (int z = -5; z < 5; ++z) {
        const auto nearest = [](int k) { return 0.2 * (k < 0 ? -k - 1 : k); };
        expected += Eigen::Vector3d(nearest(x), nearest(y), nearest(z)).norm() < 0.99;
      }
    }
  }
  REQUIRE(expected == 720);
  for (const auto& [rings, sides] : {std::pair(49, 100), std::pair(63, 128), std::pair(80, 163), std::pair(199, 400)}) {
    const shapes::Shape sphere = shapes::sphere(rings, sides);
    const TetVolume volume = tetrahedralize(sphere.vertices, sphere.triangles, {25, 0.2, false});
    CHECK(volume.cell_count == 720);
    CHECK(volume.vertices.rows() == 1015);
    CHECK(volume.tets.rows() == 4320);
    CHECK(parts(volume) == 1);
  }
}

TEST_CASE("six tets a cube in the published order, vertices sorted by x, y, z, all volumes positive") {
  const shapes::Shape cube = shapes::cube();
  const TetVolume one = voxel(cube, 1);
  REQUIRE(one.vertices.rows() == 8);
  CHECK(one.vertices.isApprox(cube.vertices));
  Tets expected(6, 4);
  expected << 0, 4, 2, 1, 4, 2, 1, 5, 2, 1, 5, 3, 4, 6, 2, 5, 6, 5, 7, 3, 6, 2, 5, 3;
  CHECK(one.tets == expected);

  const TetVolume many = voxel(shapes::sphere(20, 40), 9);
  for (Eigen::Index v = 1; v < many.vertices.rows(); ++v) {
    const auto a = many.vertices.row(v - 1), b = many.vertices.row(v);
    CHECK(std::lexicographical_compare(a.begin(), a.end(), b.begin(), b.end()));
  }
  const double size = many.cell_size * many.cell_size * many.cell_size / 6;
  for (Eigen::Index t = 0; t < many.tets.rows(); ++t) CHECK(tet_volume(many, t) == doctest::Approx(size));
}

TEST_CASE("a box on grid planes is filled exactly, and rounding does not add a layer around it") {
  shapes::Shape box = shapes::cube();
  box.vertices.col(1) *= 2;
  box.vertices.col(2) *= 3;
  for (const Eigen::RowVector3d& shift : std::vector<Eigen::RowVector3d>{
           Eigen::RowVector3d(0, 0, 0), Eigen::RowVector3d(0.1, -0.7, 1e3), Eigen::RowVector3d(1, 1, 1) / 3}) {
    const shapes::Shape there = shapes::moved(box, shift);
    CHECK(voxel(there, 6).cell_count == 2 * 4 * 6);
    const shapes::Shape rounded = {there.vertices.cast<float>().cast<double>(), there.triangles};
    if (shift.norm() < 10) CHECK(voxel(rounded, 6).cell_count == 2 * 4 * 6);
  }
  CHECK(voxel(box, 3).cell_count == 1 * 3 * 3);
  CHECK(voxel(box, 5).cell_count == 3 * 5 * 5);
}

TEST_CASE("scaling by powers of two and small shifts change nothing") {
  const shapes::Shape sphere = shapes::sphere(30, 60);
  const TetVolume plain = voxel(sphere, 12);
  shapes::Shape scaled = sphere;
  scaled.vertices *= 1024;
  CHECK(voxel(scaled, 12).tets == plain.tets);
  CHECK(voxel(shapes::moved(sphere, {3.3, -77.7, 0.123}), 12).tets == plain.tets);
}

TEST_CASE("cell_size is the same grid as the number of cells it makes") {
  const shapes::Shape sphere = shapes::sphere(30, 60);
  const TetVolume by_count = voxel(sphere, 10);
  const TetVolume by_size = tetrahedralize(sphere.vertices, sphere.triangles, {1, by_count.cell_size, false});
  CHECK(by_size.tets == by_count.tets);
}

TEST_CASE("broken surfaces give the volume of the sound one") {
  const shapes::Shape sphere = shapes::sphere(30, 60);
  const TetVolume sound = voxel(sphere, 14);
  const auto same_cells = [&](const shapes::Shape& shape) {
    const TetVolume volume = voxel(shape, 14);
    return volume.cell_count == sound.cell_count && volume.tets == sound.tets && volume.vertices.isApprox(sound.vertices, 1e-6);
  };
  SUBCASE("unwelded") { CHECK(same_cells(shapes::unwelded(sphere))); }
  SUBCASE("unwelded with rounding, every third face turned") {
    shapes::Shape torn = shapes::unwelded(sphere);
    for (Eigen::Index t = 0; t < torn.triangles.rows(); t += 3) std::swap(torn.triangles(t, 1), torn.triangles(t, 2));
    for (Eigen::Index v = 0; v < torn.vertices.rows(); ++v) torn.vertices(v, v % 3) *= 1 + 1e-7 * static_cast<double>(v % 5 - 2);
    CHECK(same_cells({torn.vertices, torn.triangles}));
  }
  SUBCASE("inside out") { CHECK(same_cells(shapes::inside_out(sphere))); }
  SUBCASE("every third face turned") {
    shapes::Shape turned = sphere;
    for (Eigen::Index t = 0; t < turned.triangles.rows(); t += 3) std::swap(turned.triangles(t, 1), turned.triangles(t, 2));
    CHECK(same_cells(turned));
  }
  SUBCASE("doubled faces, some the other way round") {
    shapes::Shape doubled = sphere;
    doubled.triangles.resize(2 * sphere.triangles.rows(), 3);
    doubled.triangles << sphere.triangles, shapes::inside_out(sphere).triangles;
    CHECK(same_cells(doubled));
  }
  SUBCASE("degenerate faces and loose vertices") {
    shapes::Shape degenerate = sphere;
    degenerate.triangles.conservativeResize(sphere.triangles.rows() + 2, 3);
    degenerate.triangles.bottomRows(2) << 5, 5, 9, 7, 7, 7;
    degenerate.vertices.conservativeResize(sphere.vertices.rows() + 1, 3);
    degenerate.vertices.bottomRows(1) << 100, 100, 100;
    CHECK(same_cells(degenerate));
  }
  SUBCASE("a hole") {
    shapes::Shape open = sphere;
    open.triangles = Triangles(sphere.triangles.bottomRows(sphere.triangles.rows() - 40));
    const TetVolume volume = voxel(open, 14);
    CHECK(volume.cell_count > 0.97 * sound.cell_count);
    CHECK(volume.cell_count <= sound.cell_count);
  }
}

TEST_CASE("parts of a mesh are solid each for itself") {
  const shapes::Shape sphere = shapes::sphere(24, 48);
  const shapes::Shape far = shapes::moved(sphere, {3, 0, 0});
  const Index one = voxel(shapes::together(sphere, far), 20).cell_count;
  SUBCASE("two spheres, one inside out") {
    const TetVolume volume = voxel(shapes::together(sphere, shapes::inside_out(far)), 20);
    CHECK(volume.cell_count == one);
    CHECK(parts(volume) == 2);
  }
  SUBCASE("crossing, one inside out: no hole where they overlap") {
    const shapes::Shape near = shapes::moved(sphere, {1, 0, 0});
    const TetVolume right = voxel(shapes::together(sphere, near), 20);
    const TetVolume wrong = voxel(shapes::together(sphere, shapes::inside_out(near)), 20);
    CHECK(wrong.tets == right.tets);
    CHECK(parts(right) == 1);
  }
  SUBCASE("one within the other, inside out") {
    shapes::Shape small = shapes::inside_out(sphere);
    small.vertices *= 0.5;
    CHECK(voxel(shapes::together(sphere, small), 20).tets == voxel(sphere, 20).tets);
  }
}

TEST_CASE("a flat sheet keeps one layer of cells, also in a grid plane") {
  shapes::Shape sheet;
  sheet.vertices.resize(4, 3);
  sheet.vertices << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0;
  sheet.triangles.resize(2, 3);
  sheet.triangles << 0, 1, 2, 0, 2, 3;
  for (const bool split : {false, true}) {
    for (const Index cells : {1, 4, 5}) {
      const TetVolume volume = voxel(sheet, cells, split);
      CHECK(volume.cell_count == cells * cells);
      CHECK(parts(volume) == 1);
    }
  }
}

TEST_CASE("a bow tie's both lobes are filled") {
  shapes::Shape bow = shapes::cube();
  for (int k = 4; k < 8; ++k) bow.vertices(k, 2) = 1 - bow.vertices(k, 2);  // the side x = 1 upside down
  const TetVolume volume = voxel(bow, 15);
  // Half of the cube, and the cells that the slanted sides cross.
  CHECK(volume.cell_count > 15 * 15 * 15 * 0.5);
  CHECK(volume.cell_count < 15 * 15 * 15 * 0.65);
  CHECK(parts(volume) == 1);
}

TEST_CASE("every vertex of the surface is reproduced by its embedding, coincident ones alike") {
  shapes::Shape shape = shapes::unwelded(shapes::sphere(20, 40));
  shape.vertices = Positions(shape.vertices * some_rotation(3).transpose());
  for (const bool split : {false, true}) {
    const TetVolume volume = voxel(shape, 9, split);
    const Positions carried = interpolate(volume.vertices, volume.tets, volume.embedding_tets, volume.embedding_weights);
    CHECK((carried - shape.vertices).cwiseAbs().maxCoeff() < 1e-13);
    CHECK((volume.embedding_weights.rowwise().sum().array() - 1).abs().maxCoeff() < 1e-15);
    CHECK(volume.embedding_weights.minCoeff() > -1e-4);
    for (Eigen::Index a = 0; a < 300; ++a) {
      for (Eigen::Index b = 0; b < a; ++b) {
        if (shape.vertices.row(a) != shape.vertices.row(b)) continue;
        CHECK(volume.embedding_tets[a] == volume.embedding_tets[b]);
        CHECK(volume.embedding_weights.row(a) == volume.embedding_weights.row(b));
      }
    }
  }
}

TEST_CASE("results do not depend on the number of threads") {
  const shapes::Shape closed = shapes::horseshoe(0.5, 0.05);
  shapes::Shape open = closed;
  open.triangles = Triangles(closed.triangles.bottomRows(closed.triangles.rows() - 100));
  const int before = omp_get_max_threads();
  for (const shapes::Shape& shape : {closed, open}) {
    omp_set_num_threads(1);
    const TetVolume alone = voxel(shape, 15, true);
    for (const int threads : {2, 4}) {
      omp_set_num_threads(threads);
      CHECK(same(voxel(shape, 15, true), alone));
    }
  }
  omp_set_num_threads(before);
}

TEST_CASE("bad input is refused by name") {
  const shapes::Shape cube = shapes::cube();
  const auto argument = [](const shapes::Shape& shape, const VoxelSettings& settings) -> std::string {
    try {
      tetrahedralize(shape.vertices, shape.triangles, settings);
    } catch (const InvalidInput& error) {
      return error.argument();
    }
    return "accepted";
  };
  CHECK(argument(cube, {0, 0, false}) == "cells");
  CHECK(argument(cube, {300, 0, false}) == "cells");
  CHECK(argument(cube, {25, -1, false}) == "cell_size");
  CHECK(argument(cube, {25, 1e-9, false}) == "cell_size");
  CHECK(argument({Positions(0, 3), Triangles(0, 3)}, {}) == "vertices");
  CHECK(argument({cube.vertices, Triangles(0, 3)}, {}) == "triangles");
  CHECK(argument({Positions::Constant(8, 3, 0.7), cube.triangles}, {}) == "vertices");
  shapes::Shape bad = cube;
  bad.vertices(3, 1) = std::nan("");
  CHECK(argument(bad, {}) == "vertices");
  bad = cube;
  bad.triangles(3, 1) = 8;
  CHECK(argument(bad, {}) == "triangles");
}
