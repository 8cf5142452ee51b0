// SPDX-License-Identifier: GPL-3.0-or-later
// Amplitude, damping and soft pins, on the true solver, on springs and on a network.
#include <doctest/doctest.h>

#include <cmath>
#include <limits>

#include "elastic/shaken_block.hpp"
#include "emulator/random_network.hpp"
#include "followthrough/controls/amplified.hpp"
#include "followthrough/controls/relative_damping.hpp"
#include "followthrough/controls/soft_pins.hpp"
#include "followthrough/elastic/predictor_corrector.hpp"
#include "followthrough/errors.hpp"
#include "followthrough/springs/springs.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

constexpr double dt = 1.0 / 24.0;

ImplicitEuler flesh(const ShakenBlock& block) { return {block.body, std::make_shared<InvertibleStVK>(), block.constrained, dt}; }

std::vector<Positions> run(Solver& solver, const ShakenBlock& block, int frames = 8) {
  solver.reset(block.reference(0));
  std::vector<Positions> result;
  for (int frame = 1; frame <= frames; ++frame) result.push_back(solver.step(block.reference(frame)));
  return result;
}

}  // namespace

TEST_CASE("an amplitude scales the displacement: 0 is the reference and 1 the solver, to the bit") {
  const ShakenBlock block;
  const Vector stiffness = Vector::Constant(block.count(), 400.0), damping = Vector::Constant(block.count(), 5.0);
  ImplicitEuler elastic = flesh(block);
  Springs springs(stiffness, damping, dt, block.constrained);
  for (Solver* solver : {static_cast<Solver*>(&elastic), static_cast<Solver*>(&springs)}) {
    const std::vector<Positions> plain = run(*solver, block);
    for (const double amplitude : {0.0, 0.5, 1.0, 2.5}) {
      CAPTURE(amplitude);
      Amplified amplified(*solver, amplitude);
      const std::vector<Positions> result = run(amplified, block);
      double moved = 0;
      for (std::size_t k = 0; k < result.size(); ++k) {
        const Positions reference = block.reference(static_cast<int>(k) + 1);
        if (amplitude == 0.0) CHECK(same_bits(result[k], reference));
        if (amplitude == 1.0) CHECK(same_bits(result[k], plain[k]));
        CHECK(((result[k] - reference) - amplitude * (plain[k] - reference)).cwiseAbs().maxCoeff() < 1e-14);
        moved = std::max(moved, (plain[k] - reference).cwiseAbs().maxCoeff());
      }
      CHECK(moved > 0.01);
    }
  }
  for (const double wrong : {-1.0, std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    CHECK_THROWS_AS(Amplified(elastic, wrong), InvalidInput);
  }
}

TEST_CASE("springs feel an amplitude as accelerations that are so many times as strong") {
  const ShakenBlock block;
  Springs springs(Vector::Constant(block.count(), 400.0), Vector::Constant(block.count(), 5.0), dt);
  Amplified amplified(springs, 3.0);
  const std::vector<Positions> result = run(amplified, block);
  const auto exaggerated = [&](int frame) {
    const Positions start = block.reference(0);
    return Positions(start + 3.0 * (block.reference(frame) - start));
  };
  springs.reset(exaggerated(0));
  for (int frame = 1; frame <= 8; ++frame) {
    const Positions displacement = springs.step(exaggerated(frame)) - exaggerated(frame);
    CHECK((result[static_cast<std::size_t>(frame) - 1] - block.reference(frame) - displacement).cwiseAbs().maxCoeff() < 1e-12);
  }
}

TEST_CASE("damping takes the speed relative to the reference, at one rate whatever the frame length") {
  // Without forces: one tet whose flesh is nothing, and a shift of all that is free.
  const ShakenBlock block;
  const double rate = 3.0;
  for (const double h : {1.0 / 24, 1.0 / 60}) {
    CAPTURE(h);
    ElasticBody light(block.block.vertices, block.block.tets,
                      {Vector::Constant(block.count(), 1e-12), Vector::Constant(block.count(), 1000.0)});
    ImplicitEuler drifting(light, std::make_shared<InvertibleStVK>(), Mask::Constant(block.count(), false), h);
    RelativeDamping damped(drifting, rate, h);
    const auto reference = [&](int frame) {  // flies by at 7 m/s
      return Positions(block.block.vertices.array() + 7.0 * h * frame);
    };
    damped.reset(reference(0));
    SolverState state = damped.state();
    const Eigen::RowVector3d velocity(0.0, 7.0, 9.0);  // of the body: relative to the reference -7, 0, 2
    state.arrays[1].rowwise() -= h * velocity;
    damped.restore(state);
    damped.damp(reference(0), reference(-1));
    const int frames = static_cast<int>(std::lround(1.0 / h));
    Positions before = reference(0), now = before;
    for (int frame = 1; frame <= frames; ++frame) {
      before = now;
      now = damped.step(reference(frame));
    }
    const Eigen::RowVector3d left = ((now - before).row(5) / h).array() - 7.0;
    CHECK((left - std::exp(-rate) * Eigen::RowVector3d(-7.0, 0.0, 2.0)).norm() < 1e-6);
  }
}

TEST_CASE("no damping and no pins leave a solver as it is, to the bit") {
  const ShakenBlock block;
  Emulator network({block.block.vertices, block.block.tets, block.constrained, block.youngs_modulus, block.density, dt},
                   random_network(3, {{8, 8}, {12, 8}, {16}, 1, true, true}));
  ImplicitEuler elastic = flesh(block);
  for (Solver* solver : {static_cast<Solver*>(&elastic), static_cast<Solver*>(&network)}) {
    const std::vector<Positions> plain = run(*solver, block);
    RelativeDamping undamped(*solver, 0.0, dt);
    SoftPins unpinned(*solver, Vector::Ones(block.count()));
    const std::vector<Positions> first = run(undamped, block), second = run(unpinned, block);
    for (std::size_t k = 0; k < plain.size(); ++k) {
      CHECK(same_bits(first[k], plain[k]));
      CHECK(same_bits(second[k], plain[k]));
    }
  }
}

TEST_CASE("pins that leave nothing hold on to the reference, and softer ones leave more") {
  const ShakenBlock block;
  double last = -1;
  for (const double share : {0.0, 0.3, 0.8, 1.0}) {
    CAPTURE(share);
    ImplicitEuler elastic = flesh(block);
    SoftPins pinned(elastic, Vector::Constant(block.count(), share));
    const std::vector<Positions> result = run(pinned, block);
    double moved = 0;
    for (std::size_t k = 0; k < result.size(); ++k) {
      moved = std::max(moved, (result[k] - block.reference(static_cast<int>(k) + 1)).cwiseAbs().maxCoeff());
    }
    CHECK(moved > last);
    if (share == 0.0) CHECK(moved == 0.0);
    last = moved;
  }
}

TEST_CASE("all controls together come back from a state bit for bit") {
  const ShakenBlock block;
  struct Stack {
    explicit Stack(const ShakenBlock& b)
        : network({b.block.vertices, b.block.tets, b.constrained, b.youngs_modulus, b.density, dt, 0.0, {0.0, 0.0, -9.81}},
                  random_network(3, {{8, 8}, {12, 8}, {16}, 1, true, true})),
          corrector(b.body, std::make_shared<InvertibleStVK>(), b.constrained, dt, {1e-2, 2, 100}),
          pins(network, Vector::LinSpaced(b.count(), 0.4, 1.0)),
          corrected(pins, corrector),
          damped(corrected, 4.0, dt),
          amplified(damped, 1.5) {}
    Emulator network;
    ImplicitEuler corrector;
    SoftPins pins;
    PredictorCorrector corrected;
    RelativeDamping damped;
    Amplified amplified;
  };
  Stack one(block), other(block);
  one.amplified.reset(block.reference(0));
  for (int frame = 1; frame <= 4; ++frame) one.amplified.step(block.reference(frame));
  const SolverState state = one.amplified.state();
  const Positions expected = one.amplified.step(block.reference(5));
  other.amplified.restore(state);
  CHECK(same_bits(other.amplified.step(block.reference(5)), expected));
  one.amplified.restore(state);
  CHECK(same_bits(one.amplified.step(block.reference(5)), expected));
}

TEST_CASE("what makes no sense is refused") {
  const ShakenBlock block;
  ImplicitEuler elastic = flesh(block);
  Springs springs(Vector::Ones(block.count()), Vector::Ones(block.count()), dt);
  CHECK_THROWS_AS(RelativeDamping(springs, 1.0, dt), InvalidInput);  // carries velocities
  CHECK_THROWS_AS(SoftPins(springs, Vector::Ones(block.count())), InvalidInput);
  CHECK_THROWS_AS(RelativeDamping(elastic, -1.0, dt), InvalidInput);
  CHECK_THROWS_AS(RelativeDamping(elastic, 1.0, 0.0), InvalidInput);
  CHECK_THROWS_AS(SoftPins(elastic, Vector::Ones(3)), InvalidInput);
  CHECK_THROWS_AS(SoftPins(elastic, Vector::Constant(block.count(), 1.5)), InvalidInput);
  RelativeDamping damped(elastic, 1.0, dt);
  CHECK_THROWS_AS(damped.step(block.reference(1)), InvalidInput);
  CHECK_THROWS_AS(damped.restore({{}, {}}), InvalidInput);
}
