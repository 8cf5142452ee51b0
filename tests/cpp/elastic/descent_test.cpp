// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/descent.hpp"

#include <doctest/doctest.h>

#include <Eigen/Geometry>

#include "elastic/blocks.hpp"
#include "elastic/local_rotations.hpp"

using namespace followthrough;

namespace {

// One vertex on a line, x^2 its energy or whatever `energy` and `slope` say.
template <typename Energy, typename Slope>
auto along_x(const Energy& energy, const Slope& slope) {
  return [=](Positions positions) {
    Trial trial;
    const double x = positions(0, 0);
    trial.energy = energy(x);
    trial.residual = Vector::Zero(3);
    trial.residual[0] = slope(x);
    trial.size = trial.relative = std::abs(slope(x));
    trial.positions = std::move(positions);
    return trial;
  };
}

}  // namespace

TEST_CASE("the minimum of a cubic is found from its ends, wherever it is") {
  for (const double least : {-0.7, 0.3, 0.9, 2.5}) {
    const auto energy = [&](double x) { return std::pow(x - least, 2) * (x - least + 9); };
    const auto slope = [&](double x) { return (x - least) * (3 * (x - least) + 18); };
    CHECK(cubic_minimum(energy(0), slope(0), energy(1), slope(1)) == doctest::Approx(least));
  }
  CHECK(std::isnan(cubic_minimum(0, 1, 5, 12)));  // x + x^2 + 3 x^3 rises everywhere
}

TEST_CASE("a search goes twice as far as Newton's method where the energy is a cubic, and back where it went too far") {
  const auto cubic = along_x([](double x) { return std::pow(std::abs(x), 3); }, [](double x) { return 3 * x * std::abs(x); });
  const auto lower = [](const Trial& from) { return [&from](const Trial& next, double) { return next.energy < from.energy; }; };
  Trial trial = cubic(Positions::Constant(1, 3, 4.0));
  Vector newton = Vector::Zero(3);
  newton[0] = -2;  // slope over curvature
  CHECK(search_along(trial, newton, {0}, 4, cubic, lower(trial)));
  CHECK(std::abs(trial.positions(0, 0)) < 0.1);

  const auto square = along_x([](double x) { return x * x; }, [](double x) { return 2 * x; });
  trial = square(Positions::Constant(1, 3, 4.0));
  newton[0] = -16;
  CHECK(search_along(trial, newton, {0}, 4, square, lower(trial)));
  CHECK(trial.positions(0, 0) == doctest::Approx(-0.0));
  newton[0] = 1;
  const Trial before = trial;
  CHECK_FALSE(search_along(trial, newton, {0}, 4, square, lower(trial)));
  CHECK(trial.positions == before.positions);
}

TEST_CASE("values turn with their neighbourhood, and stay where it is mirrored or flat") {
  const TetBlock block = tet_block(3, 2, 2, 0.2);
  const Eigen::Index count = block.vertices.rows();
  std::vector<std::array<Index, 4>> corners;
  for (Eigen::Index t = 0; t < block.tets.rows(); ++t) {
    corners.push_back({block.tets(t, 0), block.tets(t, 1), block.tets(t, 2), block.tets(t, 3)});
  }
  std::vector<Index> vertices;
  for (Index v = 1; v < count; v += 2) vertices.push_back(v);
  LocalRotations rotations(corners, count, vertices);
  const Positions values = Positions::Random(count, 3);
  for (const double angle : {0.0, 0.3, 2.0, 3.1}) {
    const Eigen::Matrix3d turn = Eigen::AngleAxisd(angle, Eigen::Vector3d(1, 2, -0.5).normalized()).toRotationMatrix();
    const Positions moved = (3.0 * block.vertices * turn.transpose()).array() + 5.0;  // the size makes no difference
    Positions turned = values;
    rotations.turn(block.vertices, moved, turned);
    for (Eigen::Index v = 0; v < count; ++v) {
      const Eigen::RowVector3d expected = v % 2 == 1 ? (values.row(v) * turn.transpose()).eval() : values.row(v).eval();
      CHECK((turned.row(v) - expected).norm() < (v % 2 == 1 ? 1e-5 : 1e-15));
    }
  }
  Positions odd = block.vertices;
  for (const double scale : {-1.0, 0.0}) {
    odd.col(1) = scale * block.vertices.col(1);
    Positions turned = values;
    rotations.turn(block.vertices, odd, turned);
    CHECK((turned - values).norm() < 1e-6);
  }
}
