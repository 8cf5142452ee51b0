// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/quasistatic/quasistatic.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <cmath>
#include <limits>

#include "elastic/blocks.hpp"
#include "followthrough/errors.hpp"
#include "followthrough/quasistatic/over_quasistatic.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

struct Scene {
  TetBlock block;
  ElasticBody body;
  Mask constrained;
};

Scene scene(int nx, int ny, int nz) {
  TetBlock block = tet_block(nx, ny, nz, 0.2);
  const Eigen::Index count = block.vertices.rows();
  ElasticBody body(block.vertices, block.tets, {Vector::LinSpaced(count, 2e4, 2e5), Vector::Constant(count, 1000.0)});
  Mask constrained = block.vertices.col(0).array() < 0.1 || block.vertices.col(0).array() > 0.2 * nx - 0.1;
  return {std::move(block), std::move(body), std::move(constrained)};
}

// Sheared across and bent.
Positions posed(const Positions& rest, double amount) {
  Positions pose = rest;
  pose.col(1) += amount * rest.col(0);
  pose.col(2) += 0.5 * amount * rest.col(0).cwiseAbs2();
  return pose;
}

}  // namespace

TEST_CASE("forces cancel at the equilibrium, with pins and weight, of either material") {
  const Scene s = scene(5, 2, 2);
  const Eigen::Index count = s.body.vertex_count();
  const StaticForces forces{{0, 0, -9.81}, Vector::LinSpaced(count, 0.0, 100.0)};
  for (const std::shared_ptr<const Material>& material :
       {std::shared_ptr<const Material>(std::make_shared<InvertibleStVK>()),
        std::shared_ptr<const Material>(std::make_shared<CorotationalLinear>())}) {
    Quasistatic layer(s.body, material, s.constrained, {}, forces);
    const Positions pose = posed(s.block.vertices, 0.4);
    const Positions& x = layer.solve(pose);
    CHECK(layer.last_solve().converged);
    Positions left = s.body.internal_forces(x, *material);
    left += forces.pin_stiffness.asDiagonal() * (x - pose);
    left -= s.body.mass_product(forces.gravity.transpose().replicate(count, 1));
    double held = 0, free = 0;
    for (Eigen::Index v = 0; v < count; ++v) (s.constrained[v] ? held : free) += left.row(v).squaredNorm();
    CHECK(std::sqrt(free) < 1e-8 * std::sqrt(held));
  }
}

TEST_CASE("tets without a free corner do not count") {
  Scene s = scene(4, 2, 2);
  s.constrained = s.block.vertices.col(0).array() < 0.1 || s.block.vertices.col(0).array() > 0.5;  // the last cell too
  Positions pose = posed(s.block.vertices, 0.3);
  Quasistatic layer(s.body, std::make_shared<InvertibleStVK>(), s.constrained);
  const Positions expected = layer.solve(pose);
  for (Eigen::Index v = 0; v < pose.rows(); ++v) {
    if (s.block.vertices(v, 0) > 0.7) pose(v, 0) -= 5;
  }
  layer.forget();
  Positions found = layer.solve(pose);
  CHECK(layer.last_solve().converged);
  for (Eigen::Index v = 0; v < pose.rows(); ++v) {
    if (!s.constrained[v]) CHECK((found.row(v) - expected.row(v)).norm() == 0);
  }
}

TEST_CASE("the same bits at any number of threads") {
  const Scene s = scene(16, 12, 12);
  const int before = omp_get_max_threads();
  Positions expected;
  for (const int threads : {1, 2, 4}) {
    omp_set_num_threads(threads);
    Quasistatic layer(s.body, std::make_shared<InvertibleStVK>(), s.constrained, EquilibriumSettings::preview());
    layer.solve(posed(s.block.vertices, 0.2));
    const Positions& found = layer.solve(posed(s.block.vertices, 0.3));
    if (threads == 1) expected = found;
    CHECK(same_bits(found, expected));
  }
  omp_set_num_threads(before);
}

TEST_CASE("bad input is refused and changes nothing") {
  const Scene s = scene(2, 1, 1);
  const Eigen::Index count = s.body.vertex_count();
  const auto material = std::make_shared<InvertibleStVK>();
  CHECK_THROWS_AS(Quasistatic(s.body, material, Mask::Constant(count, true)), InvalidInput);
  CHECK_THROWS_AS(Quasistatic(s.body, material, Mask::Constant(count - 1, false)), InvalidInput);
  CHECK_THROWS_AS(Quasistatic(s.body, material, s.constrained, {0.0, 1, 1}), InvalidInput);
  CHECK_THROWS_AS(Quasistatic(s.body, material, Mask::Constant(count, false), {}, {{0, 0, -1}, {}}), InvalidInput);
  Quasistatic layer(s.body, material, s.constrained);
  OverQuasistatic solver(layer);
  CHECK_THROWS_AS(solver.step(s.block.vertices), InvalidInput);
  solver.reset(s.block.vertices);
  const Positions expected = solver.step(posed(s.block.vertices, 0.3));
  const SolverState state = solver.state();
  Positions broken = s.block.vertices;
  broken(3, 1) = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(solver.step(broken), InvalidInput);
  CHECK_THROWS_AS(solver.step(s.block.vertices, &broken), InvalidInput);
  CHECK_THROWS_AS(solver.restore(SolverState{}), InvalidInput);
  CHECK(same_bits(solver.state().arrays[0], expected));
  CHECK(solver.state().counters == state.counters);
}
