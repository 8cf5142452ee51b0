// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/backward_euler_force.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <cstring>

#include "elastic/blocks.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

using namespace followthrough;

namespace {

constexpr double dt = 1.0 / 30;
using Precision = BackwardEulerForce::Precision;

struct Scene {
  TetBlock block;
  ElasticBody body;
};

Scene scene(int nx, int ny, int nz) {
  TetBlock block = tet_block(nx, ny, nz, 0.2);
  const Eigen::Index count = block.vertices.rows();
  ElasticBody body(block.vertices, block.tets, {Vector::LinSpaced(count, 2e4, 2e5), Vector::LinSpaced(count, 800.0, 1200.0)});
  return {std::move(block), std::move(body)};
}

// What an elastic force is measured against: the largest one.
double largest(const Positions& force) { return force.cwiseAbs().maxCoeff(); }

}  // namespace

TEST_CASE("the backward Euler force is mass times acceleration plus elastic forces, inverted tets included") {
  for (const auto& [nx, ny, nz] : {std::array{1, 1, 1}, std::array{3, 2, 2}, std::array{7, 5, 3}}) {
    const Scene s = scene(nx, ny, nz);
    const Eigen::Index count = s.body.vertex_count();
    for (const double size : {0.0, 0.01, 0.05, 0.3}) {
      const Positions x = s.block.vertices + size * Positions::Random(count, 3), y = x + 0.1 * Positions::Random(count, 3);
      const Positions expected = s.body.mass_product(x - y) + dt * dt * s.body.internal_forces(x, InvertibleStVK());
      Positions force(count, 3);
      BackwardEulerForce(s.body, dt).evaluate(x, y, force);
      CHECK(largest(force - expected) <= 1e-14 * largest(expected));
      SingleForces single(count, 3);
      BackwardEulerForce(s.body, dt, Precision::kSingle).evaluate(x, y, single);
      CHECK(largest(single.cast<double>() - expected) <= 2e-6 * largest(expected));
    }
  }
}

TEST_CASE("single precision does not depend on where the body is") {
  const Scene s = scene(4, 3, 2);
  const Eigen::Index count = s.body.vertex_count();
  const Positions x = s.block.vertices + 0.02 * Positions::Random(count, 3), y = x - 0.01 * Positions::Random(count, 3);
  BackwardEulerForce evaluation(s.body, dt, Precision::kSingle);
  Positions near(count, 3), far(count, 3);
  evaluation.evaluate(x, y, near);
  evaluation.evaluate(x.array() + 1e4, y.array() + 1e4, far);
  CHECK(largest(far - near) <= 1e-6 * largest(near));
}

TEST_CASE("the backward Euler force has the same bits for any number of threads and with every instruction set") {
  const Scene s = scene(36, 36, 30);  // large enough that threads share the work
  const Eigen::Index count = s.body.vertex_count();
  const Positions x = s.block.vertices + 0.04 * Positions::Random(count, 3), y = s.block.vertices;
  const int usual_threads = omp_get_max_threads();
  const InstructionSet usual_set = instruction_set();
  for (const Precision precision : {Precision::kDouble, Precision::kSingle}) {
    BackwardEulerForce evaluation(s.body, dt, precision);
    std::vector<Positions> results;
    for (const InstructionSet set : available_instruction_sets()) {
      use_instruction_set(set);
      for (const int threads : {1, 2, 4}) {
        omp_set_num_threads(threads);
        evaluation.evaluate(x, y, results.emplace_back(count, 3));
        CHECK(std::memcmp(results.back().data(), results.front().data(), sizeof(double) * static_cast<std::size_t>(3 * count)) ==
              0);
      }
    }
  }
  omp_set_num_threads(usual_threads);
  use_instruction_set(usual_set);
}

TEST_CASE("wrong shapes and steps are refused") {
  const Scene s = scene(1, 1, 1);
  const Positions x = s.block.vertices;
  Positions force(x.rows(), 3);
  CHECK_THROWS_WITH_AS(BackwardEulerForce(s.body, -1.0), doctest::Contains("dt"), InvalidInput);
  BackwardEulerForce evaluation(s.body, dt);
  CHECK_THROWS_WITH_AS(evaluation.evaluate(x.topRows(3), x, force), doctest::Contains("positions"), InvalidInput);
  CHECK_THROWS_WITH_AS(evaluation.evaluate(x, x.topRows(3), force), doctest::Contains("inertial"), InvalidInput);
  CHECK_THROWS_WITH_AS(evaluation.evaluate(x, x, force.topRows(3)), doctest::Contains("force"), InvalidInput);
}
