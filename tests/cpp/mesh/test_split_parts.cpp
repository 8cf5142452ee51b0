// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>

#include <Eigen/Geometry>

#include <algorithm>
#include <cmath>
#include <set>

#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/surface_transfer.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "shapes.hpp"

using namespace followthrough;

namespace {

TetVolume voxel(const shapes::Shape& shape, Index cells, bool split = true) {
  return tetrahedralize(shape.vertices, shape.triangles, {cells, 0, split});
}

int parts(const TetVolume& volume) { return connected_parts(volume.tets, volume.vertices.rows()).maxCoeff() + 1; }

// Vertices of the volume that carry the surface's vertices for which `chosen` holds.
template <typename Chosen>
std::set<Index> carriers(const TetVolume& volume, Eigen::Index count, Chosen&& chosen) {
  std::set<Index> result;
  for (Eigen::Index v = 0; v < count; ++v) {
    if (!chosen(v)) continue;
    for (int k = 0; k < 4; ++k) result.insert(volume.tets(volume.embedding_tets[v], k));
  }
  return result;
}

std::size_t shared(const std::set<Index>& a, const std::set<Index>& b) {
  return static_cast<std::size_t>(std::count_if(a.begin(), a.end(), [&](Index v) { return b.count(v) > 0; }));
}

// The first half of the horseshoe's vertices is its left leg, whatever it overlaps; `low` keeps away from the arc.
std::size_t shared_by_legs(const shapes::Shape& shape, const TetVolume& volume, double low) {
  const Eigen::Index count = shape.vertices.rows();
  const auto leg = [&](bool left) {
    return carriers(volume, count, [&](Eigen::Index v) {
      const bool own = v == 0 || (v > 1 && v < count / 2);
      return own == left && shape.vertices(v, 2) < low;
    });
  };
  return shared(leg(true), leg(false));
}

}  // namespace

TEST_CASE("legs with a narrow gap, touching or overlapping a little, are not glued") {
  for (const double gap : {0.3, 0.05, 1e-4, 0.0, -1e-4, -0.02, -0.1}) {
    for (const Index cells : {9, 12, 20, 25}) {
      CAPTURE(gap);
      CAPTURE(cells);
      const shapes::Shape shape = shapes::horseshoe(0.5, gap);
      const TetVolume split = voxel(shape, cells), plain = voxel(shape, cells, false);
      CHECK(parts(split) == 1);
      CHECK(shared_by_legs(shape, split, -0.8) == 0);
      if (gap < 0.01) CHECK(shared_by_legs(shape, plain, -0.8) > 10);
      const Positions carried = interpolate(split.vertices, split.tets, split.embedding_tets, split.embedding_weights);
      CHECK((carried - shape.vertices).cwiseAbs().maxCoeff() < 1e-12);
    }
  }
}

TEST_CASE("fingers are not glued") {
  for (const double gap : {0.1, 0.02}) {
    for (const Index cells : {15, 20, 25}) {
      CAPTURE(gap);
      CAPTURE(cells);
      const shapes::Shape shape = shapes::hand(gap);
      for (const double angle : {0.05, 0.0}) {  // as hands are held, and along the grid: the fingertips in one of its planes
        CAPTURE(angle);
        shapes::Shape turned = shape;
        turned.vertices =
            Positions(shape.vertices * Eigen::AngleAxisd(angle, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix());
        const TetVolume split = voxel(turned, cells), plain = voxel(turned, cells, false);
        const auto finger = [&](const TetVolume& volume, int number) {
          return carriers(volume, shape.vertices.rows(), [&](Eigen::Index v) {
            const double x = shape.vertices(v, 0) - number * (0.8 + gap);
            return shape.vertices(v, 2) > 2.5 && x > -1e-9 && x < 0.8 + 1e-9;
          });
        };
        CHECK(parts(split) == 1);
        for (int number = 0; number < 3; ++number) {
          CHECK(shared(finger(split, number), finger(split, number + 1)) == 0);
          CHECK(shared(finger(plain, number), finger(plain, number + 1)) > 0);
        }
      }
    }
  }
}

TEST_CASE("lips are not glued, and the corners of the mouth hold") {
  for (const double slit : {0.1, 0.02}) {
    for (const Index cells : {10, 16, 25}) {
      CAPTURE(slit);
      CAPTURE(cells);
      const shapes::Shape shape = shapes::head(slit);
      const TetVolume split = voxel(shape, cells), plain = voxel(shape, cells, false);
      const auto lip = [&](const TetVolume& volume, double height) {
        return carriers(volume, shape.vertices.rows(), [&](Eigen::Index v) {
          const Eigen::RowVector3d at = shape.vertices.row(v);
          return std::abs(at[2] - height) < 1e-9 && at[1] < 1.3 && at[0] > 1.2 && at[0] < 2.8;
        });
      };
      CHECK(parts(split) == 1);
      CHECK(shared(lip(split, 2), lip(split, 2 + slit)) == 0);
      CHECK(shared(lip(plain, 2), lip(plain, 2 + slit)) > 0);
    }
  }
}

TEST_CASE("a point on one leg stays where it is when the other leg's volume moves") {
  const shapes::Shape shape = shapes::horseshoe(0.5, 0.01);
  const TetVolume volume = voxel(shape, 12);
  const Eigen::Index count = shape.vertices.rows();
  Positions moved = volume.vertices;
  for (const Index v :
       carriers(volume, count, [&](Eigen::Index s) { return s > 1 && s < count / 2 && shape.vertices(s, 2) < -0.8; })) {
    moved(v, 0) -= 1;
  }
  const Positions surface = interpolate(moved, volume.tets, volume.embedding_tets, volume.embedding_weights);
  for (Eigen::Index v = count / 2 + 1; v < count; ++v) {
    if (shape.vertices(v, 2) < -0.8) CHECK(surface.row(v).isApprox(shape.vertices.row(v), 1e-12));
  }
}

TEST_CASE("weights come from the own leg, not from the nearer skin of the other one") {
  const shapes::Shape shape = shapes::horseshoe(0.5, 0.02);
  const TetVolume volume = voxel(shape, 12);
  const Eigen::Index count = shape.vertices.rows();
  Values left = Values::Zero(count, 1);
  left(0, 0) = 1;
  for (Eigen::Index v = 2; v < count / 2; ++v) left(v, 0) = 1;
  const SurfaceTransfer transfer(shape.vertices, shape.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                 volume.own_triangles);
  const Values carried = interpolate(transfer(left), volume.tets, volume.embedding_tets, volume.embedding_weights);
  for (Eigen::Index v = 2; v < count; ++v) {
    if (shape.vertices(v, 2) < -1) CHECK(carried(v, 0) == doctest::Approx(left(v, 0)).epsilon(0.02));
  }
}

TEST_CASE("shapes without near parts come out as they do without splitting") {
  std::vector<shapes::Shape> plain = {shapes::cube(), shapes::sphere(20, 40), shapes::sphere(80, 160), shapes::horseshoe(0.4, 2)};
  shapes::Shape flat = shapes::sphere(40, 80);
  flat.vertices.col(1) *= 0.3;
  flat.vertices.col(2) *= 0.03;  // front and back in the same cells, with material between
  plain.push_back(flat);
  shapes::Shape turned = flat;
  turned.vertices = Positions(flat.vertices * Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix());
  plain.push_back(turned);
  for (const shapes::Shape& shape : plain) {
    for (const Index cells : {3, 8, 17, 25}) {
      const TetVolume split = voxel(shape, cells), whole = voxel(shape, cells, false);
      CHECK(split.vertices == whole.vertices);
      CHECK(split.tets == whole.tets);
      CHECK(split.embedding_tets == whole.embedding_tets);
    }
  }
}

TEST_CASE("a ring that closes on itself keeps its ends apart") {
  // A rod bent almost to a full circle, its ends nearly touching.
  const shapes::Shape ring = shapes::tube(200, 24, [](double along, double angle) -> Eigen::RowVector3d {
    const double ease = std::clamp(along * 1.02 - 0.01, 0.0, 1.0), turn = 0.02 + ease * (2 * std::numbers::pi - 0.04);
    const double thickness = along <= 0 || along >= 1 ? 0.0 : 0.3;
    const Eigen::RowVector3d outward(std::cos(turn), std::sin(turn), 0);
    return (1 + thickness * std::cos(angle)) * outward + thickness * std::sin(angle) * Eigen::RowVector3d(0, 0, 1);
  });
  const TetVolume volume = voxel(ring, 13);
  CHECK(parts(volume) == 1);
  const auto end = [&](bool first) {
    return carriers(volume, ring.vertices.rows(), [&](Eigen::Index v) {
      return ring.vertices(v, 0) > 0 && std::abs(ring.vertices(v, 1)) < 0.15 && (ring.vertices(v, 1) > 0) == first;
    });
  };
  CHECK(shared(end(true), end(false)) == 0);
  const TetVolume plain = voxel(ring, 13, false);
  CHECK(volume.vertices.rows() > plain.vertices.rows());
}

TEST_CASE("pieces of a mesh that overlap, lie inside or close to a larger one stay with it") {
  const shapes::Shape body = shapes::sphere(40, 80);
  shapes::Shape small = shapes::sphere(12, 24, 0.12);
  for (const double distance : {0.5, 0.95, 1.0, 1.1, 1.15}) {
    CAPTURE(distance);
    CHECK(parts(voxel(shapes::together(body, shapes::moved(small, {distance, 0, 0})), 15)) == 1);
  }
  CHECK(parts(voxel(shapes::together(body, shapes::moved(small, {2, 0, 0})), 15)) == 2);
}

TEST_CASE("a trouser leg hangs on the thigh in it and not on the other one") {
  const shapes::Shape legs = shapes::horseshoe(0.5, 0.06);
  // Open tube around the left leg.
  shapes::Shape cloth = shapes::tube(20, 40, [](double along, double angle) -> Eigen::RowVector3d {
    return {-0.53 + 0.515 * std::cos(angle), 0.515 * std::sin(angle), -2 + along};
  });
  cloth.triangles = Triangles(cloth.triangles(Eigen::seq(0, Eigen::indexing::last), Eigen::indexing::all));
  const TetVolume volume = voxel(shapes::together(legs, cloth), 12);
  CHECK(parts(volume) == 1);
  CHECK(shared_by_legs(legs, volume, -0.8) == 0);
}
