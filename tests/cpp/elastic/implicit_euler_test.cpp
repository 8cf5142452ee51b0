// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/implicit_euler.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "elastic/block_matrix.hpp"
#include "elastic/blocks.hpp"
#include "elastic/compact_order.hpp"
#include "elastic/conjugate_gradients.hpp"
#include "elastic/element_batch.hpp"
#include "elastic/lane_system.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

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
  ElasticConstants constants{Vector::LinSpaced(count, 2e4, 2e5), Vector::LinSpaced(count, 800.0, 1200.0)};
  ElasticBody body(block.vertices, block.tets, constants);
  Mask constrained = block.vertices.col(0).array() < 0.1;
  return {std::move(block), std::move(body), std::move(constrained)};
}

Positions shaken(const Positions& rest, int frame) {
  Positions reference = rest;
  reference.col(1).array() += 0.15 * std::sin(0.9 * frame);
  reference.col(2).array() += 0.1 * std::sin(0.5 * frame) * rest.col(0).array();
  return reference;
}

PaddedPositions padded(const Positions& positions) {
  PaddedPositions all;
  for (Eigen::Index v = 0; v < positions.rows(); ++v) all.push_back({positions(v, 0), positions(v, 1), positions(v, 2), 0});
  return all;
}

// The system of the mass and so many times the stiffness.
bool assemble(const ElasticBody& body, const Positions& positions, Definiteness definiteness, double scale, LaneSystem& lanes) {
  const ElasticBody::Selection selection = body.select(lanes.part_tets());
  const PaddedPositions at = padded(positions);
  const auto fill = [&](std::size_t part, float* to) {
    body.element_stiffness(selection, lanes.part_starts()[part], lanes.part_starts()[part + 1], at, InvertibleStVK(), definiteness,
                           scale * lanes.unit(), to);
  };
  return lanes.assemble(fill, true);
}

}  // namespace

TEST_CASE("assembled stiffness and mass are the element by element products") {
  const Scene s = scene(3, 2, 2);
  const Eigen::Index count = s.body.vertex_count();
  std::vector<Index> rows(static_cast<std::size_t>(count));
  for (Eigen::Index v = 0; v < count; ++v) rows[v] = static_cast<Index>(v);
  const Positions bent = s.block.vertices + 0.06 * Positions::Random(count, 3), change = Positions::Random(count, 3);
  const InvertibleStVK stvk;
  for (const Definiteness definiteness : {Definiteness::kSymmetric, Definiteness::kSemidefinite}) {
    BlockMatrix matrix(s.body.corners(), rows);
    s.body.add_stiffness(bent, stvk, definiteness, 1e-3, matrix);
    s.body.add_mass(0.5, matrix);
    const Positions expected =
        1e-3 * s.body.stiffness_product(bent, change, stvk, definiteness) + 0.5 * s.body.mass_product(change);
    Positions product(count, 3);
    matrix.multiply(change.data(), product.data());
    CHECK((product - expected).norm() < 1e-12 * expected.norm());
  }
}

TEST_CASE("conjugate gradients solve to the tolerance and say where a matrix is indefinite") {
  const Scene s = scene(4, 2, 2);
  std::vector<Index> rows(static_cast<std::size_t>(s.body.vertex_count()));
  for (std::size_t v = 0; v < rows.size(); ++v) rows[v] = static_cast<Index>(v);
  const Vector b = Vector::Random(3 * s.body.vertex_count());
  for (const double sign : {1.0, -1.0}) {
    BlockMatrix matrix(s.body.corners(), rows);
    s.body.add_mass(1.0, matrix);
    s.body.add_stiffness(s.block.vertices, InvertibleStVK(), Definiteness::kSemidefinite, sign * 1e-3, matrix);
    BlockDiagonal preconditioner;
    preconditioner.compute(matrix);
    Vector x, product(b.size());
    const LinearReport report = solve(matrix, preconditioner, b, 1e-10, 1000, x);
    CHECK(report.negative_curvature == (sign < 0));
    if (sign > 0) {
      matrix.multiply(x.data(), product.data());
      CHECK((product - b).norm() < 2e-10 * b.norm());
    }
  }
}

TEST_CASE("lanes hold the same system in single precision, elements beyond the clamp included, with every instruction set") {
  const Scene s = scene(5, 3, 2);
  std::vector<Index> rows(static_cast<std::size_t>(s.body.vertex_count()), -1);
  Index count = 0;
  for (std::size_t v = 0; v < rows.size(); ++v) {
    if (!s.constrained[static_cast<Eigen::Index>(v)]) rows[v] = count++;
  }
  Positions bent = shaken(s.block.vertices, 3);
  bent.row(bent.rows() - 1) = bent.row(0);  // inverts some elements
  BlockMatrix matrix(s.body.corners(), rows);
  s.body.add_mass(1.0, matrix);
  LaneSystem lanes(matrix, s.body.corners().size());
  const Vector b = Vector::LinSpaced(3 * count, -1, 2);
  const InstructionSet usual = instruction_set();
  for (const Definiteness definiteness : {Definiteness::kConvex, Definiteness::kSemidefinite}) {
    BlockMatrix exact = matrix;
    s.body.add_stiffness(bent, InvertibleStVK(), definiteness, 1e-3, exact);
    BlockDiagonal diagonal;
    REQUIRE(diagonal.compute(exact));
    Vector expected, first, product(b.size());
    REQUIRE(solve(exact, diagonal, b, 1e-10, 2000, expected).converged);
    for (const InstructionSet set : available_instruction_sets()) {
      use_instruction_set(set);
      REQUIRE(assemble(s.body, bent, definiteness, 1e-3, lanes));
      Vector x;
      REQUIRE(lanes.solve(b, 1e-5, 2000, x).converged);
      exact.multiply(x.data(), product.data());
      CHECK((product - b).norm() < 1e-4 * b.norm());
      CHECK((x - expected).norm() < 1e-3 * expected.norm());
      if (first.size() == 0) first = x;
      CHECK(x == first);
    }
    use_instruction_set(usual);
  }
}

TEST_CASE("lanes say where a system is indefinite") {
  const Scene s = scene(4, 2, 2);
  std::vector<Index> rows(static_cast<std::size_t>(s.body.vertex_count()));
  for (std::size_t v = 0; v < rows.size(); ++v) rows[v] = static_cast<Index>(v);
  BlockMatrix mass(s.body.corners(), rows);
  s.body.add_mass(1.0, mass);
  LaneSystem lanes(mass, s.body.corners().size());
  // The diagonal alone says so.
  CHECK_FALSE(assemble(s.body, s.block.vertices, Definiteness::kSemidefinite, -1e-3, lanes));
  double scale = -1e-3;  // just small enough for the diagonal: too large for the rest
  do {
    scale *= 0.9;
  } while (!assemble(s.body, s.block.vertices, Definiteness::kSemidefinite, scale, lanes));
  Vector x;
  CHECK(lanes.solve(Vector::LinSpaced(3 * mass.row_count(), -1, 2), 1e-5, 2000, x).negative_curvature);
  CHECK(x.allFinite());
}

TEST_CASE("the coarse system is the matrix on aggregates, and leaves the answer as it is") {
  const Scene s = scene(17, 9, 8);  // several parts
  std::vector<Index> free, rows(static_cast<std::size_t>(s.body.vertex_count()), -1);
  for (Index v = 0; v < s.body.vertex_count(); ++v) {
    if (!s.constrained[v]) free.push_back(v);
  }
  order_compactly(s.body.rest_positions(), row_lanes, LaneSystem::part_rows, free);
  for (std::size_t row = 0; row < free.size(); ++row) rows[free[row]] = static_cast<Index>(row);
  const auto size = static_cast<Eigen::Index>(3 * free.size());
  const Positions bent = shaken(s.block.vertices, 3) + 0.01 * Positions::Random(s.body.vertex_count(), 3);
  BlockMatrix mass(s.body.corners(), rows);
  s.body.add_mass(1.0, mass);
  BlockMatrix exact = mass;
  s.body.add_stiffness(bent, InvertibleStVK(), Definiteness::kConvex, 0.1, exact);
  LaneSystem lanes(mass, s.body.corners().size());
  REQUIRE(lanes.part_starts().size() > 3);
  REQUIRE(assemble(s.body, bent, Definiteness::kConvex, 0.1, lanes));
  REQUIRE(lanes.has_coarse());
  LaneSystem plain = lanes;
  plain.drop_coarse();

  // Symmetric and positive definite.
  const Vector a = Vector::Random(size), b = Vector::Random(size);
  const Vector za = lanes.preconditioned(a), zb = lanes.preconditioned(b);
  CHECK(a.dot(zb) == doctest::Approx(b.dot(za)).epsilon(1e-4).scale(a.norm() * zb.norm()));
  CHECK(a.dot(za) > a.dot(plain.preconditioned(a)));
  CHECK(a.dot(plain.preconditioned(a)) > 0);

  // Exact where aggregates move as a whole: Galerkin's.
  constexpr Eigen::Index aggregate = row_lanes * aggregate_groups;
  Vector whole(size), force(size);
  const Positions moves = Positions::Random(size / 3 / aggregate + 1, 3);
  for (Eigen::Index row = 0; row < size / 3; ++row) whole.segment<3>(3 * row) = moves.row(row / aggregate).transpose();
  exact.multiply(whole.data(), force.data());
  const Vector found = lanes.preconditioned(force) - plain.preconditioned(force);
  CHECK((found - whole).norm() < 1e-3 * whole.norm());

  const InstructionSet usual = instruction_set();
  Vector expected, first;
  const LinearReport without = plain.solve(a, 1e-5, 2000, expected);
  REQUIRE(without.converged);
  for (const InstructionSet set : available_instruction_sets()) {
    use_instruction_set(set);
    REQUIRE(assemble(s.body, bent, Definiteness::kConvex, 0.1, lanes));
    Vector x;
    const LinearReport with = lanes.solve(a, 1e-5, 2000, x);
    CHECK(with.converged);
    CHECK(with.iterations < 0.8 * without.iterations);
    CHECK((x - expected).norm() < 1e-3 * expected.norm());
    if (first.size() == 0) first = x;
    CHECK(x == first);
  }
  use_instruction_set(usual);
}

TEST_CASE("compactly ordered vertices form cubes of a grid") {
  const TetBlock block = tet_block(7, 7, 15, 0.5);
  std::vector<Index> vertices(8 * 8 * 16);
  for (std::size_t v = 0; v < vertices.size(); ++v) vertices[v] = static_cast<Index>(v);
  std::vector<Index> sorted = vertices;
  order_compactly(block.vertices, 16, 128, sorted);
  for (std::size_t first = 0; first < sorted.size(); first += 64) {
    Positions run(64, 3);
    for (Eigen::Index k = 0; k < 64; ++k) run.row(k) = block.vertices.row(sorted[first + static_cast<std::size_t>(k)]);
    CHECK((run.colwise().maxCoeff() - run.colwise().minCoeff()).maxCoeff() == 1.5);
  }
  std::sort(sorted.begin(), sorted.end());
  CHECK(sorted == vertices);
}

TEST_CASE("steps have the same bits for any number of threads, and resume from a state") {
  const Scene s = scene(18, 13, 13);  // large enough that threads share the work
  const int usual = omp_get_max_threads();
  std::vector<Positions> expected;
  for (const int threads : {1, 2, 4}) {
    omp_set_num_threads(threads);
    ImplicitEuler solver(s.body, std::make_shared<InvertibleStVK>(), s.constrained, 1.0 / 30, NewtonSettings::preview());
    solver.reset(shaken(s.block.vertices, 0));
    for (int frame = 1; frame < 4; ++frame) {
      if (frame == 2) {
        const SolverState state = solver.state();
        solver.step(shaken(s.block.vertices, 7));
        solver.restore(state);
      }
      const Positions& dynamic = solver.step(shaken(s.block.vertices, frame));
      if (threads == 1) expected.push_back(dynamic);
      const Positions& same = expected[static_cast<std::size_t>(frame - 1)];
      CHECK(std::memcmp(dynamic.data(), same.data(), sizeof(double) * static_cast<std::size_t>(dynamic.size())) == 0);
    }
  }
  omp_set_num_threads(usual);
}

TEST_CASE("steps have the same bits with every instruction set") {
  const Scene s = scene(4, 2, 2);
  const InstructionSet usual = instruction_set();
  std::vector<Positions> expected;
  for (const InstructionSet set : available_instruction_sets()) {
    use_instruction_set(set);
    ImplicitEuler solver(s.body, std::make_shared<InvertibleStVK>(), s.constrained, 1.0 / 30);
    solver.reset(s.block.vertices);
    for (int frame = 1; frame < 4; ++frame) solver.step(shaken(s.block.vertices, frame));
    expected.push_back(solver.state().arrays[0]);
    CHECK(std::memcmp(expected.back().data(), expected.front().data(),
                      sizeof(double) * static_cast<std::size_t>(expected.front().size())) == 0);
  }
  use_instruction_set(usual);
}

TEST_CASE("the closed form gives the forces and the stiffness of the decomposition") {
  // A material that the closed form does not know, with the same response.
  class Decomposed final : public Material {
   public:
    PrincipalResponse respond(const Eigen::Vector3d& stretches, const Moduli& constants) const override {
      return InvertibleStVK().respond(stretches, constants);
    }
  };
  const Scene s = scene(3, 2, 2);
  const Eigen::Index count = s.body.vertex_count();
  std::vector<Index> rows(static_cast<std::size_t>(count));
  for (Eigen::Index v = 0; v < count; ++v) rows[v] = static_cast<Index>(v);
  for (const double size : {0.0, 0.01, 0.05, 0.2}) {
    const Positions bent = s.block.vertices + size * Positions::Random(count, 3), change = Positions::Random(count, 3);
    double energy = 0, expected_energy = 0;
    const Positions forces = s.body.internal_forces(bent, InvertibleStVK(), &energy);
    const Positions expected = s.body.internal_forces(bent, Decomposed(), &expected_energy);
    CHECK((forces - expected).norm() <= 1e-12 * expected.norm() + 1e-9);
    CHECK(energy == doctest::Approx(expected_energy).epsilon(1e-12));
    Positions products[2] = {Positions(count, 3), Positions(count, 3)};
    for (const bool closed : {false, true}) {
      BlockMatrix matrix(s.body.corners(), rows);
      const InvertibleStVK stvk;
      const Decomposed decomposed;
      s.body.add_stiffness(bent, closed ? static_cast<const Material&>(stvk) : decomposed, Definiteness::kSymmetric, 1.0, matrix);
      matrix.multiply(change.data(), products[closed].data());
    }
    CHECK((products[0] - products[1]).norm() < 1e-12 * products[0].norm());
  }
}

TEST_CASE("the convex stiffness has no negative eigenvalue and is the exact one under tension") {
  const Scene s = scene(3, 2, 2);
  const Eigen::Index count = s.body.vertex_count();
  std::vector<Index> rows(static_cast<std::size_t>(count));
  for (Eigen::Index v = 0; v < count; ++v) rows[v] = static_cast<Index>(v);
  const auto dense = [&](const Positions& positions, Definiteness definiteness) {
    BlockMatrix matrix(s.body.corners(), rows);
    s.body.add_stiffness(positions, InvertibleStVK(), definiteness, 1.0, matrix);
    Eigen::MatrixXd all(3 * count, 3 * count);
    for (Eigen::Index k = 0; k < 3 * count; ++k) {
      const Vector unit = Vector::Unit(3 * count, k);
      matrix.multiply(unit.data(), all.col(k).data());
    }
    return all;
  };
  for (const double size : {0.01, 0.05, 0.2}) {
    const Positions bent = s.block.vertices + size * Positions::Random(count, 3);
    const Eigen::VectorXd values = Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(dense(bent, Definiteness::kConvex)).eigenvalues();
    CHECK(values.minCoeff() > -1e-12 * values.maxCoeff());
    CHECK(Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd>(dense(bent, Definiteness::kSymmetric)).eigenvalues().minCoeff() <
          -1e-6 * values.maxCoeff());
  }
  const Positions stretched = 1.1 * s.block.vertices;
  const Eigen::MatrixXd exact = dense(stretched, Definiteness::kSymmetric);
  CHECK((dense(stretched, Definiteness::kConvex) - exact).norm() < 1e-12 * exact.norm());
}

TEST_CASE("bad input is refused and changes nothing") {
  Scene s = scene(2, 1, 1);
  const Eigen::Index count = s.body.vertex_count();
  const auto stvk = std::make_shared<InvertibleStVK>();
  CHECK_THROWS_WITH_AS(ImplicitEuler(s.body, stvk, Mask::Constant(count, true), 0.03), doctest::Contains("no free vertex"),
                       InvalidInput);
  CHECK_THROWS_AS(ImplicitEuler(s.body, stvk, Mask::Constant(count - 1, false), 0.03), InvalidInput);
  CHECK_THROWS_AS(ImplicitEuler(s.body, stvk, s.constrained, 0.0), InvalidInput);
  ImplicitEuler solver(s.body, stvk, s.constrained, 0.03);
  CHECK_THROWS_AS(solver.step(s.block.vertices), InvalidInput);
  solver.reset(s.block.vertices);
  Positions broken = s.block.vertices;
  broken(1, 1) = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(solver.step(broken), InvalidInput);
  CHECK(solver.state().counters[0] == 0);

  Positions flat = s.block.vertices;
  flat.col(2).setZero();
  const ElasticConstants constants{Vector::Constant(count, 1e5), Vector::Constant(count, 1e3)};
  CHECK_THROWS_WITH_AS(ElasticBody(flat, s.block.tets, constants), doctest::Contains("tet 0 has no volume"), InvalidInput);
  ElasticConstants negative = constants;
  negative.youngs_modulus[3] = -1;
  CHECK_THROWS_WITH_AS(ElasticBody(s.block.vertices, s.block.tets, negative), doctest::Contains("youngs_modulus"), InvalidInput);
  Tets beyond = s.block.tets;
  beyond(0, 0) = static_cast<Index>(count);
  CHECK_THROWS_AS(ElasticBody(s.block.vertices, beyond, constants), InvalidInput);
}
