// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/patch_newton.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <memory>
#include <random>

#include "emulator/newton_problem.hpp"
#include "emulator/plain_newton.hpp"
#include "emulator/random_network.hpp"
#include "emulator/step_guard.hpp"
#include "followthrough/elastic/implicit_euler.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

constexpr double edge = 0.2;

// Largest distance, in edges.
double difference(const Positions& a, const Positions& b) { return (a - b).cwiseAbs().maxCoeff() / edge; }

std::vector<Positions> run(Solver& solver, const Positions& rest, int frames) {
  solver.reset(swinging(rest, 0));
  std::vector<Positions> result;
  for (int frame = 1; frame <= frames; ++frame) result.push_back(solver.step(swinging(rest, frame)));
  return result;
}

// Cubes whose inner vertices are off the grid, with rigid and soft parts, and two vertices inside that are constrained.
NewtonBody bent_block(int nx, int ny, int nz) {
  NewtonBody body{block_of_cubes(nx, ny, nz, edge)};
  std::mt19937 random(7);
  std::uniform_real_distribution<double> off(-0.02, 0.02), density(700.0, 1500.0);
  for (Eigen::Index v = 0; v < body.rest_positions.rows(); ++v) {
    for (Eigen::Index k = 0; k < 3; ++k) body.rest_positions(v, k) += off(random);
    body.density[v] = density(random);
  }
  body.youngs_modulus = body.youngs_modulus.array() / 20.0;
  body.constrained[body.constrained.size() - 3] = true;
  return body;
}

// Positions, and the same again aside.
Positions twice(const Positions& x) {
  Positions both(2 * x.rows(), 3);
  both << x, x.rowwise() + Eigen::RowVector3d(0.0, 0.0, 5.0);
  return both;
}

NewtonBody two_of(const NewtonBody& one) {
  const Eigen::Index n = one.rest_positions.rows();
  NewtonBody two = one;
  two.rest_positions = twice(one.rest_positions);
  two.tets.resize(2 * one.tets.rows(), 4);
  two.tets << one.tets, one.tets.array() + static_cast<Index>(n);
  two.constrained.resize(2 * n);
  two.constrained << one.constrained, one.constrained;
  two.youngs_modulus.resize(2 * n);
  two.youngs_modulus << one.youngs_modulus, one.youngs_modulus;
  two.density.resize(2 * n);
  two.density << one.density, one.density;
  return two;
}

struct Compared {
  PlainNewton plain;
  double moved;  // away from the reference at most, edges
};

// Six frames of a swing, so many times as fast, are those of the plain one.
Compared check_against_plain(const NewtonBody& body, const NewtonSchedule& schedule, double bound, int speed = 1) {
  Compared result{{body, schedule}, 0.0};
  PatchNewton fast(body, schedule);
  result.plain.reset(swinging(body.rest_positions, 0));
  fast.reset(swinging(body.rest_positions, 0));
  for (int frame = 1; frame <= 6; ++frame) {
    const Positions reference = swinging(body.rest_positions, speed * frame), expected = result.plain.step(reference);
    CHECK(difference(fast.step(reference), expected) < bound);
    result.moved = std::max(result.moved, difference(expected, reference));
  }
  return result;
}

std::vector<NewtonWidths> no_networks() { return {{8, false, {}}, {16, false, {}}, {32, false, {}}}; }
std::vector<NewtonWidths> two_networks() { return {{4, true, {24, 24}}, {6, true, {16}}, {12, false, {}}}; }

}  // namespace

TEST_CASE("guided Newton passes are the plain ones, with every architecture and instruction set") {
  const Usual usual;
  const std::vector<std::vector<NewtonWidths>> all = {
      two_networks(),   {}, {{3, true, {1}}}, {{0, true, {70, 31, 9}}, {5, true, {17, 16}}}, {{2, true, {}}, {2, true, {5, 40, 3}}},
      {{7, false, {}}},
  };
  const NewtonBody body = bent_block(4, 2, 2);
  int from_reference = 0;
  for (std::size_t a = 0; a < all.size(); ++a) {
    CAPTURE(a);
    NewtonSchedule schedule = random_schedule(static_cast<unsigned>(a), all[a]);
    if (a == 0) schedule.most_passes = 5;  // the last one is repeated
    for (const InstructionSet set : available_instruction_sets()) {
      CAPTURE(name_of(set));
      use_instruction_set(set);
      const Compared compared = check_against_plain(body, schedule, 1e-4);
      CHECK(compared.moved > 0.05);
      from_reference += compared.plain.from_reference;
    }
  }
  CHECK(from_reference > 0);
}

TEST_CASE("guided Newton passes are the plain ones where tets reach from one part of the rows into others") {
  const Usual usual;
  const NewtonBody body = bent_block(10, 7, 7);
  // So many iterations that no pass leaves about half of the residual, where rounding would say how many the next one has.
  const NewtonSchedule schedule = random_schedule(15, {{12, true, {24, 24}}, {6, true, {16}}, {12, false, {}}});
  PlainNewton plain(body, schedule);
  plain.reset(swinging(body.rest_positions, 0));
  std::vector<Positions> expected;
  for (int frame = 1; frame <= 3; ++frame) expected.push_back(plain.step(swinging(body.rest_positions, frame)));
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    PatchNewton fast(body, schedule);
    const std::vector<Positions> result = run(fast, body.rest_positions, 3);
    for (std::size_t f = 0; f < result.size(); ++f) CHECK(difference(result[f], expected[f]) < 1e-4);
  }
}

TEST_CASE("a body so large that its matrix is kept in 16 bits moves as each of the two that it consists of") {
  const Usual usual;
  const NewtonBody one = bent_block(10, 8, 8), two = two_of(one);
  const NewtonSchedule schedule = random_schedule(16, no_networks());
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    PatchNewton alone(one, schedule), together(two, schedule);
    CHECK(together.free_vertex_count() == 2 * alone.free_vertex_count());
    const Positions rest = swinging(one.rest_positions, 0);
    alone.reset(rest);
    together.reset(twice(rest));
    for (int frame = 1; frame <= 6; ++frame) {
      // From the same state every time, as folds make much of the least difference.
      SolverState state = alone.state();
      for (Positions& array : state.arrays) array = twice(array);
      together.restore(state);
      const Positions moved = swinging(one.rest_positions, frame), expected = twice(alone.step(moved));
      const double off = (together.step(twice(moved)) - expected).norm() / std::sqrt(static_cast<double>(expected.size())) / edge;
      CHECK(off < 1e-3);  // coarse systems see to the two in other portions
      CHECK(difference(expected, state.arrays[0]) > 0.5);
    }
  }
}

TEST_CASE("a matrix in 16 bits has the direction of the one in 32, solved well enough that preconditioning does not count") {
  const Usual usual;
  const NewtonBody one = bent_block(10, 8, 8);
  const NewtonBody two = two_of(one);
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    NewtonProblem alone(one), together(two);
    CHECK(alone.rounded_blocks.empty());
    CHECK_FALSE(together.rounded_blocks.empty());
    const Positions rest = one.rest_positions, moved = swinging(rest, 1), both = twice(rest), both_moved = twice(moved);
    alone.begin({{rest, rest, rest, rest}, {moved, rest, rest, rest}});
    together.begin({{both, both, both, both}, {both_moved, both, both, both}});
    for (NewtonProblem* problem : {&alone, &together}) {
      problem->assemble(Tangent::convex);
      problem->solve(400, 1e-5);
      problem->move_along_direction();
    }
    Positions found(both.rows(), 3), expected(rest.rows(), 3);
    together.write_estimate(found);
    alone.write_estimate(expected);
    CHECK(alone.direction_length() > 0.01);
    CHECK(difference(found, twice(expected)) < 2e-4);
  }
}

TEST_CASE("where conjugate gradients find directions, the tangent is the exact one near the end") {
  const Usual usual;
  const NewtonBody body = bent_block(4, 2, 2);
  NewtonSchedule schedule = random_schedule(31, {{200, true, {16}}});
  schedule.most_passes = 7;
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    CHECK(check_against_plain(body, schedule, 1e-3).plain.exact_passes > 6);
  }
}

TEST_CASE("an exact tangent that is indefinite gives way to the convex one") {
  const Usual usual;
  NewtonBody body = bent_block(8, 2, 2);
  body.youngs_modulus *= 400.0;
  const auto squeezed = [&](double share) { return Positions(body.rest_positions * Eigen::Vector3d(share, 1, 1).asDiagonal()); };
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    // Where even blocks of the diagonal are not positive definite, and where flesh is about to buckle.
    for (const double share : {0.5, 0.93}) {
      CAPTURE(share);
      const Positions now = squeezed(share);
      NewtonProblem exact(body), convex(body);
      for (NewtonProblem* problem : {&exact, &convex}) problem->begin({{now, now, now, now}, {now, now, now, now}});
      const double left = exact.assemble(Tangent::exact);
      CHECK(exact.tet_frame.exact == (share > 0.6));
      if (!exact.tet_frame.exact) CHECK(left == convex.assemble(Tangent::convex));
      convex.assemble(Tangent::convex);
      exact.solve(200);
      convex.solve(200);
      CHECK_FALSE(exact.tet_frame.exact);
      CHECK(exact.slope == convex.slope);
      CHECK(exact.slope < 0.0);
      CHECK(exact.direction_length() == convex.direction_length());
    }
  }
}

TEST_CASE("a guide's step that makes the energy worse is not kept, with every instruction set") {
  const Usual usual;
  const NewtonBody body = bent_block(4, 2, 2);
  // Guides that go far too far, from a start as usual.
  NewtonSchedule schedule = random_schedule(21, {{6, true, {16}}, {12, true, {16}}, {12, true, {16}}}, 20.0f);
  schedule.start = random_schedule(22, {}).start;
  schedule.most_passes = 6;
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    CHECK(check_against_plain(body, schedule, 1e-3, 4).plain.not_kept >= 6);  // faster than it can follow
  }
}

TEST_CASE("results do not depend on threads, and instruction sets differ by rounding") {
  const Usual usual;
  const NewtonSchedule schedule = random_schedule(1, two_networks());
  for (const bool large : {false, true}) {
    // So large that more than one thread has enough to do.
    const NewtonBody body = large ? bent_block(24, 17, 17) : bent_block(14, 9, 9);
    std::vector<Positions> first, widest;
    for (const InstructionSet set : available_instruction_sets()) {
      CAPTURE(name_of(set));
      use_instruction_set(set);
      first.clear();
      for (const int threads : {1, 2, 3, 4}) {
        omp_set_num_threads(threads);
        PatchNewton solver(body, schedule);
        const std::vector<Positions> result = run(solver, body.rest_positions, 3);
        if (first.empty()) first = result;
        for (std::size_t f = 0; f < result.size(); ++f) CHECK(same_bits(result[f], first[f]));
      }
      // The large body's matrix is kept in 16 bits, whose rounding guides with random weights make too much of.
      if (large) continue;
      if (widest.empty()) widest = first;
      // Folds make much of rounding.
      for (std::size_t f = 0; f < first.size(); ++f) CHECK(difference(first[f], widest[f]) < 1e-3);
    }
  }
}

TEST_CASE("what is at rest stays there, to the bit") {
  for (const bool bent : {false, true}) {
    const NewtonBody body = bent ? bent_block(4, 3, 2) : NewtonBody{block_of_cubes(4, 3, 2, edge)};
    NewtonSchedule schedule = random_schedule(3, two_networks());
    PatchNewton solver(body, schedule);
    solver.reset(body.rest_positions);
    for (int frame = 0; frame < 50; ++frame) CHECK(same_bits(solver.step(body.rest_positions), body.rest_positions));
    // Carried along without turning, too, but for what differences of numbers far away lose.
    const Eigen::RowVector3d speed(0.3, -0.2, 0.1);
    for (int frame = 1; frame < 20; ++frame) {
      const Positions moved = body.rest_positions.rowwise() + frame * speed;
      const auto before = [&](double frames) -> Positions { return moved.rowwise() - frames * speed; };
      solver.restore({{moved, before(1), before(2), before(3), moved, before(1), before(2)}, {3}});
      CHECK(difference(solver.step(moved.rowwise() + speed), moved.rowwise() + speed) < 1e-12);
    }
  }
}

TEST_CASE("a scene that is turned and moved as a whole moves turned and moved, also far away") {
  const NewtonBody body = bent_block(5, 2, 2);
  const NewtonSchedule schedule = random_schedule(4, two_networks());
  Eigen::Matrix3d turn;
  turn = Eigen::AngleAxisd(2.1, Eigen::Vector3d(1, -2, 0.5).normalized());
  for (const double distance : {0.0, 5000.0}) {
    const auto placed = [&](const Positions& x) -> Positions {
      return (x * turn.transpose()).rowwise() + Eigen::RowVector3d(distance, -distance, 3.0);
    };
    PatchNewton here(body, schedule), there(body, schedule);
    here.reset(swinging(body.rest_positions, 0));
    there.reset(placed(swinging(body.rest_positions, 0)));
    for (int frame = 1; frame <= 8; ++frame) {
      const Positions expected = placed(here.step(swinging(body.rest_positions, frame)));
      CHECK(difference(there.step(placed(swinging(body.rest_positions, frame))), expected) < 1e-4);
    }
  }
}

TEST_CASE("a scene in other units gives the same motion in those units") {
  const NewtonBody body = bent_block(5, 2, 2);
  const NewtonSchedule schedule = random_schedule(5, two_networks());
  PatchNewton usual(body, schedule);
  const std::vector<Positions> expected = run(usual, body.rest_positions, 8);
  for (const double size : {0.01, 1.0, 100.0}) {
    for (const double slowness : {0.5, 3.0}) {
      for (const double density : {0.01, 20.0}) {
        NewtonBody other = body;
        other.rest_positions *= size;
        other.dt *= slowness;
        other.density *= density;
        other.youngs_modulus *= density * size * size / (slowness * slowness);
        PatchNewton scaled(other, schedule);
        CHECK(scaled.edge_length() == doctest::Approx(usual.edge_length() * size));
        CHECK((scaled.stiffness() - usual.stiffness()).cwiseAbs().maxCoeff() < 1e-9 * usual.stiffness().maxCoeff());
        scaled.reset(size * swinging(body.rest_positions, 0));
        for (std::size_t f = 0; f < expected.size(); ++f) {
          const Positions result = scaled.step(size * swinging(body.rest_positions, static_cast<int>(f) + 1));
          CHECK(difference(result / size, expected[f]) < 1e-4);
        }
      }
    }
  }
}

TEST_CASE("with enough passes a frame is backward Euler's own") {
  const NewtonBody body = bent_block(4, 2, 2);
  const ElasticBody elastic(body.rest_positions, body.tets, {body.youngs_modulus, body.density});
  for (const bool with_network : {false, true}) {
    NewtonSchedule schedule = random_schedule(6, {{4, with_network, {32, 32}}});
    schedule.extra_passes = 60;
    schedule.extra_iterations = 40;
    PatchNewton passes(body, schedule);
    ImplicitEuler exact(elastic, std::make_shared<InvertibleStVK>(), body.constrained, body.dt);
    passes.reset(swinging(body.rest_positions, 0));
    exact.reset(swinging(body.rest_positions, 0));
    for (int frame = 1; frame <= 20; ++frame) {
      const Positions reference = swinging(body.rest_positions, frame);
      const Positions expected = exact.step(reference);
      REQUIRE(exact.last_step().converged);
      CHECK(difference(passes.step(reference), expected) < 1e-4);
    }
  }
}

TEST_CASE("soft pins are springs in the equations, as backward Euler's") {
  const Usual usual;
  NewtonBody body = bent_block(4, 2, 2);
  const ElasticBody elastic(body.rest_positions, body.tets, {body.youngs_modulus, body.density});
  const NewtonBody loose = body;
  // As strong as inertia at some, and none at others.
  body.pin_stiffness = elastic.lumped_mass() / (body.dt * body.dt);
  for (Eigen::Index v = 0; v < body.pin_stiffness.size(); v += 3) body.pin_stiffness[v] = 0.0;
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    check_against_plain(body, random_schedule(41, two_networks()), 1e-4);
  }
  NewtonSchedule schedule = random_schedule(6, {{4, true, {32, 32}}});
  schedule.extra_passes = 60;
  schedule.extra_iterations = 40;
  for (const Eigen::Vector3d& gravity : {Eigen::Vector3d(0, 0, 0), Eigen::Vector3d(1, -2, -9.81)}) {
    body.gravity = gravity;
    ExternalForces forces;
    forces.gravity = gravity;
    forces.pin_stiffness = body.pin_stiffness;
    PatchNewton passes(body, schedule), free_of_pins(loose, schedule);
    ImplicitEuler exact(elastic, std::make_shared<InvertibleStVK>(), body.constrained, body.dt, {}, forces);
    for (Solver* solver : std::initializer_list<Solver*>{&passes, &exact, &free_of_pins})
      solver->reset(swinging(body.rest_positions, 0));
    for (int frame = 1; frame <= 12; ++frame) {
      const Positions reference = swinging(body.rest_positions, frame);
      const Positions expected = exact.step(reference);
      REQUIRE(exact.last_step().converged);
      CHECK(difference(passes.step(reference), expected) < 2e-4);
      CHECK(difference(free_of_pins.step(reference), expected) > 0.02);
    }
  }
}

TEST_CASE("violence leaves it finite, and it comes back to rest") {
  const NewtonBody body = bent_block(5, 3, 3);
  const Positions& rest = body.rest_positions;
  NewtonSchedule schedule = random_schedule(8, two_networks());
  schedule.extra_passes = 2;
  // A network that always goes wrong, too.
  const NewtonSchedule wild = random_schedule(9, two_networks(), 1e4f);
  std::vector<std::vector<Positions>> motions(5);
  for (int frame = 0; frame < 6; ++frame) {
    motions[0].push_back(rest.rowwise() + Eigen::RowVector3d(frame % 2 ? 1e4 : 0.0, 0, 0));       // teleports
    motions[1].push_back(rest * Eigen::Vector3d(1, frame % 2 ? -1 : 1, 1).asDiagonal());          // flips
    motions[2].push_back(rest * (frame % 3 == 1 ? 0.0 : 1.0));                                    // vanishes
    motions[3].push_back(Positions::Random(rest.rows(), 3) * 3.0);                                // is torn apart
    motions[4].push_back(rest.rowwise() + Eigen::RowVector3d(0, frame % 2 ? 1e150 : -1e150, 0));  // overflows floats
  }
  for (const NewtonSchedule& passes : {schedule, wild}) {
    for (std::size_t m = 0; m < motions.size(); ++m) {
      CAPTURE(m);
      PatchNewton solver(body, passes);
      solver.reset(motions[m].front());
      for (const Positions& reference : motions[m]) CHECK(solver.step(reference).allFinite());
      for (int frame = 0; frame < 400; ++frame) REQUIRE(solver.step(rest).allFinite());
      if (&passes != &schedule || m == 4) continue;
      CHECK(difference(solver.step(rest), rest) < 1e-3);
    }
  }
}

TEST_CASE("what training sees, step by step, is what the solver does") {
  const NewtonBody body = bent_block(4, 3, 2);
  NewtonSchedule schedule = random_schedule(10, {{5, false, {}}, {3, false, {}}});
  // A start that carries half of w, and nothing else.
  schedule.start.back().weight.setZero();
  schedule.start.back().bias.setZero();
  schedule.start.back().bias[0] = 0.5f;
  PatchNewton solver(body, schedule);
  NewtonPatches patches(body);
  std::vector<Positions> x, u;
  for (int frame = 0; frame < 8; ++frame) x.push_back(swinging(body.rest_positions, std::max(frame - 3, 0)));
  solver.reset(x[0]);
  for (int frame = 0; frame < 4; ++frame) u.push_back(x[0]);
  for (std::size_t frame = 4; frame < x.size(); ++frame) {
    patches.begin({{u[frame - 1], u[frame - 2], u[frame - 3], u[frame - 4]}, {x[frame], x[frame - 1], x[frame - 2], x[frame - 3]}});
    const PatchFeatures start = patches.start_features();
    CHECK(start.vectors.cols() == 3 * start_guide_size().vectors);
    CHECK(start.scalars.cols() == start_guide_size().scalars);
    patches.move(0.5f * start.vectors.leftCols<3>());
    double before = std::numeric_limits<double>::infinity();
    for (const int iterations : {5, 3}) {
      const double left = patches.evaluate(iterations);
      CHECK(left < before);
      before = left;
      const PatchFeatures features = patches.features();
      CHECK(features.vectors.cols() == 3 * pass_guide_size().vectors);
      CHECK(features.scalars.cols() == pass_guide_size().scalars);
      const NewtonPatches::Steps direction = patches.direction();
      CHECK(features.vectors.leftCols<3>() == direction);
      patches.move(direction);
    }
    u.push_back(solver.step(x[frame]));
    CHECK(difference(patches.estimate(), u.back()) < 1e-6);
  }
}

TEST_CASE("passes end where little is left, calm frames being solved as exactly in proportion") {
  const NewtonBody body = bent_block(5, 3, 3);
  NewtonSchedule schedule = random_schedule(13, {{10, true, {16}}});
  schedule.most_passes = 30;
  const auto off = [&](double tolerance, double size) {
    schedule.tolerance = tolerance;
    NewtonSchedule exact = schedule;
    exact.tolerance = 0.0;
    PatchNewton solver(body, schedule), truth(body, exact);
    double worst = 0;
    for (PatchNewton* s : {&solver, &truth}) s->reset(body.rest_positions);
    for (int frame = 1; frame <= 6; ++frame) {
      const Positions moved = body.rest_positions + size * (swinging(body.rest_positions, frame) - body.rest_positions);
      truth.restore(solver.state());
      const Positions expected = truth.step(moved);
      worst = std::max(worst, difference(solver.step(moved), expected));
    }
    return worst;
  };
  const double loose = off(1e-2, 1.0), tight = off(1e-4, 1.0), calm = off(1e-2, 1e-3);
  CHECK(loose > 1e-5);
  CHECK(loose < 0.2);
  CHECK(tight < 0.2 * loose);
  CHECK(calm < 0.05 * loose);
}

TEST_CASE("a direction that ends a frame unseen leaves no more than is enough, and a frame's first one never ends it") {
  const Usual usual;
  const NewtonBody body = bent_block(5, 3, 3);
  constexpr int iterations = 64;
  for (const InstructionSet set : available_instruction_sets()) {
    CAPTURE(name_of(set));
    use_instruction_set(set);
    for (const double enough : {1e-2, 1e-3, 1e-4}) {
      CAPTURE(enough);
      NewtonProblem problem(body);
      StepGuard guard(problem);
      std::vector<Positions> x, u(4, body.rest_positions);
      for (int frame = 0; frame < 16; ++frame) x.push_back(swinging(body.rest_positions, std::max(frame - 3, 0)));
      int ended = 0;
      for (std::size_t frame = 4; frame < x.size(); ++frame) {
        problem.begin({{u[0], u[1], u[2], u[3]}, {x[frame], x[frame - 1], x[frame - 2], x[frame - 3]}});
        guard.begin();
        double reach = 1.0, expected = 1.0;
        bool ends = false;
        for (int k = 0; k < 12 && !ends; ++k) {
          const double left = guard.evaluate(guard.tangent(expected));
          expected = guard.expected_error(reach);
          problem.solve(iterations);
          guard.has_solved(iterations);
          reach = problem.direction_length() / left;
          ends = guard.ends_frame(reach, enough);
          CHECK_FALSE((ends && k == 0));  // nothing is known of how much a step leaves
          if (!ends) guard.before_step(false, false);
          problem.move_along_direction();
        }
        ended += ends;
        if (ends) CHECK(guard.evaluate() < enough);
        std::rotate(u.begin(), u.end() - 1, u.end());
        u[0] = body.rest_positions;
        problem.write_estimate(u[0]);
      }
      CHECK(ended == 12);
    }
  }
}

TEST_CASE("gravity is what a falling frame of reference feels") {
  NewtonBody body = bent_block(4, 2, 2);
  const NewtonSchedule schedule = random_schedule(14, two_networks());
  PatchNewton floating(body, schedule);
  body.gravity = {0.0, 0.0, -9.81};
  PatchNewton falling(body, schedule);
  floating.reset(body.rest_positions);
  falling.reset(body.rest_positions);
  // Held by a frame that falls itself, a body has no weight.
  for (int frame = 1; frame <= 6; ++frame) {
    const auto fallen = [&](int f) -> Eigen::RowVector3d { return 0.5 * f * f * body.dt * body.dt * body.gravity.transpose(); };
    const auto placed = [&](int f) -> Positions { return swinging(body.rest_positions, f).rowwise() + fallen(f); };
    SolverState state = floating.state();
    for (std::size_t k = 0; k < 7; ++k) state.arrays[k].rowwise() += fallen(frame - 1 - static_cast<int>(k < 4 ? k : k - 4));
    falling.restore(state);
    const Positions expected = floating.step(swinging(body.rest_positions, frame));
    CHECK(difference(falling.step(placed(frame)), expected.rowwise() + fallen(frame)) < 1e-4);
  }
}

TEST_CASE("a state resumes the run, to the bit") {
  const NewtonBody body = bent_block(4, 2, 2);
  const NewtonSchedule schedule = random_schedule(11, two_networks());
  PatchNewton solver(body, schedule), other(body, schedule);
  const std::vector<Positions> start = run(solver, body.rest_positions, 5);
  const SolverState state = solver.state();
  const Positions expected = solver.step(swinging(body.rest_positions, 6));
  other.restore(state);
  CHECK(same_bits(other.step(swinging(body.rest_positions, 6)), expected));
  CHECK(other.state().counters == std::vector<std::int64_t>{6});
}

TEST_CASE("what does not fit is refused, naming it") {
  const NewtonBody body = bent_block(2, 2, 2);
  const NewtonSchedule schedule = random_schedule(12, two_networks());
  const auto refused = [](const auto& what, const std::string& argument) {
    CAPTURE(argument);
    try {
      what();
      CHECK(false);
    } catch (const InvalidInput& error) {
      CHECK(error.argument() == argument);
    }
  };
  const auto with_schedule = [&](auto change) {
    NewtonSchedule changed = schedule;
    change(changed);
    return [&body, changed] { PatchNewton(body, changed); };
  };
  refused(with_schedule([](NewtonSchedule& s) { s.passes[0].iterations = -1; }), "passes.0.iterations");
  refused(with_schedule([](NewtonSchedule& s) { s.passes[0].guide[1].weight.resize(24, 31); }), "passes.0.guide.1.weight");
  refused(with_schedule([](NewtonSchedule& s) { s.passes[0].guide[1].bias.resize(3); }), "passes.0.guide.1.bias");
  refused(with_schedule([](NewtonSchedule& s) { s.passes[1].guide.pop_back(); }), "passes.1.guide.0.weight");
  refused(with_schedule([](NewtonSchedule& s) { s.start.clear(); }), "start");
  refused(with_schedule([](NewtonSchedule& s) { s.start[0].bias[3] = NAN; }), "start.0.bias");
  refused(with_schedule([](NewtonSchedule& s) { s.start[2].weight(1, 1) = INFINITY; }), "start.2.weight");
  refused(with_schedule([](NewtonSchedule& s) { s.most_passes = -1; }), "most_passes");
  refused(with_schedule([](NewtonSchedule& s) { s.tolerance = NAN; }), "tolerance");
  refused(with_schedule([](NewtonSchedule& s) { s.extra_passes = -1; }), "extra_passes");
  refused(with_schedule([](NewtonSchedule& s) { s.extra_iterations = -1; }), "extra_iterations");
  const auto with_body = [&](auto change) {
    NewtonBody changed = body;
    change(changed);
    return [changed] { const NewtonPatches patches(changed); };
  };
  refused(with_body([](NewtonBody& b) { b.tets(0, 0) = -1; }), "tets");
  refused(with_body([](NewtonBody& b) { b.tets.resize(0, 4); }), "tets");
  refused(with_body([](NewtonBody& b) { b.tets(3, 1) = b.tets(3, 0); }), "rest_positions");
  refused(with_body([](NewtonBody& b) { b.tets.conservativeResize(1, 4); }), "tets");
  refused(with_body([](NewtonBody& b) { b.rest_positions(2, 1) = INFINITY; }), "rest_positions");
  refused(with_body([](NewtonBody& b) { b.youngs_modulus[3] = 0.0; }), "youngs_modulus");
  refused(with_body([](NewtonBody& b) { b.density.resize(2); }), "density");
  refused(with_body([](NewtonBody& b) { b.constrained.resize(2); }), "constrained");
  refused(with_body([](NewtonBody& b) { b.dt = NAN; }), "dt");
  refused(with_body([](NewtonBody& b) { b.edge_length = -1.0; }), "edge_length");
  refused(with_body([](NewtonBody& b) { b.poisson_ratio = 0.5; }), "poisson_ratio");
  refused(with_body([](NewtonBody& b) { b.compression_resistance = -1.0; }), "compression_resistance");
  refused(with_body([](NewtonBody& b) { b.pin_stiffness = Vector::Ones(2); }), "pin_stiffness");
  refused(with_body([](NewtonBody& b) { b.pin_stiffness = Vector::Constant(b.density.size(), -1.0); }), "pin_stiffness");

  NewtonPatches patches(body);
  const Positions& rest = body.rest_positions;
  refused([&] { patches.evaluate(3); }, "estimate");
  refused([&] { patches.start_features(); }, "estimate");
  refused([&] { patches.begin({{rest, rest, rest.topRows(3), rest}, {rest, rest, rest, rest}}); }, "dynamic[2]");
  patches.begin({{rest, rest, rest, rest}, {rest, rest, rest, rest}});
  refused([&] { patches.features(); }, "estimate");
  refused([&] { patches.evaluate(-3); }, "iterations");
  patches.evaluate(3);
  refused([&] { patches.move(NewtonPatches::Steps::Zero(2, 3)); }, "step");

  PatchNewton solver(body, schedule);
  refused([&] { solver.step(rest); }, "reference");
  solver.reset(rest);
  Positions broken = rest;
  broken(1, 1) = NAN;
  const SolverState state = solver.state();
  refused([&] { solver.step(broken); }, "reference");
  refused([&] { solver.step(broken.topRows(3)); }, "reference");
  refused([&] { solver.reset(broken); }, "reference");
  SolverState foreign = state;
  foreign.arrays.pop_back();
  refused([&] { solver.restore(foreign); }, "state");
  const SolverState after = solver.state();
  for (std::size_t k = 0; k < state.arrays.size(); ++k) CHECK(same_bits(after.arrays[k], state.arrays[k]));
}
