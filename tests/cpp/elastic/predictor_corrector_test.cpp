// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/predictor_corrector.hpp"

#include <doctest/doctest.h>

#include <cstring>
#include <limits>

#include "elastic/shaken_block.hpp"
#include "emulator/random_network.hpp"
#include "followthrough/errors.hpp"

using namespace followthrough;

namespace {

/// Says anything, and knows no better: no prediction at all where `offset` is not finite.
class Guess final : public Solver {
 public:
  explicit Guess(Eigen::Index count, double offset) : count_(count), offset_(offset) {}
  Eigen::Index vertex_count() const override { return count_; }
  void reset(ConstPositions reference) override { now_ = before_ = reference; }
  const Positions& step(ConstPositions reference, const Positions* /*next_reference*/) override {
    before_ = now_;
    now_ = reference.array() + offset_;
    return now_;
  }
  SolverState state() const override { return {{now_, before_}, {0}}; }
  std::size_t frames_in_state() const override { return 2; }
  void restore(const SolverState& state) override {
    now_ = state.arrays[0];
    before_ = state.arrays[1];
  }

 private:
  Eigen::Index count_;
  double offset_;
  Positions now_, before_;
};

ImplicitEuler solver(const ShakenBlock& block, int most_iterations, double tolerance = 1e-9) {
  return {block.body, std::make_shared<InvertibleStVK>(), block.constrained, 1.0 / 24, {tolerance, most_iterations, 500}};
}

Emulator network(const ShakenBlock& block) {
  return {{block.block.vertices, block.block.tets, block.constrained, block.youngs_modulus, block.density, 1.0 / 24},
          random_network(3, {{8, 8}, {12, 8}, {16}, 1, true, true})};
}

}  // namespace

TEST_CASE("iterations without end are the true solver, whoever predicts") {
  const ShakenBlock block;
  ImplicitEuler truth = solver(block, 100);
  for (const double offset : {0.0, 0.02, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    CAPTURE(offset);
    Guess guess(block.count(), offset);
    ImplicitEuler corrector = solver(block, 100);
    PredictorCorrector both(guess, corrector);
    truth.reset(block.reference(0));
    both.reset(block.reference(0));
    for (int frame = 1; frame <= 8; ++frame) {
      const Positions& expected = truth.step(block.reference(frame));
      CHECK((both.step(block.reference(frame)) - expected).cwiseAbs().maxCoeff() < 1e-7);
      CHECK(both.last_step().converged);
    }
  }
}

TEST_CASE("where a good prediction is there, nothing is left to correct") {
  const ShakenBlock block;
  ImplicitEuler predictor = solver(block, 100), corrector = solver(block, 100, 1e-6), alone = solver(block, 100);
  PredictorCorrector both(predictor, corrector);
  both.reset(block.reference(0));
  alone.reset(block.reference(0));
  for (int frame = 1; frame <= 5; ++frame) {
    const Positions corrected = both.step(block.reference(frame));
    CHECK(both.last_step().iterations == 0);
    CHECK(corrected == alone.step(block.reference(frame)));
  }
}

TEST_CASE("every iteration more brings a network's motion nearer to the true one") {
  const ShakenBlock block;
  double last = std::numeric_limits<double>::infinity();
  for (const int iterations : {1, 2, 4, 30}) {
    CAPTURE(iterations);
    Emulator predictor = network(block);
    ImplicitEuler corrector = solver(block, iterations), truth = solver(block, 100);
    PredictorCorrector both(predictor, corrector);
    both.reset(block.reference(0));
    truth.reset(block.reference(0));
    double off = 0;
    for (int frame = 1; frame <= 10; ++frame) {
      off += (both.step(block.reference(frame)) - truth.step(block.reference(frame))).squaredNorm();
      CHECK(both.last_step().iterations <= iterations);
    }
    CHECK(off < last);
    last = off;
  }
  CHECK(last < 1e-12);
}

TEST_CASE("a state brings predictor and corrector back bit for bit") {
  const ShakenBlock block;
  Emulator predictor = network(block), other_predictor = network(block);
  ImplicitEuler corrector = solver(block, 2), other_corrector = solver(block, 2);
  PredictorCorrector both(predictor, corrector), other(other_predictor, other_corrector);
  other.restore(both.state());  // nothing yet
  CHECK_THROWS_AS(other.step(block.reference(1)), InvalidInput);
  both.reset(block.reference(0));
  for (int frame = 1; frame <= 4; ++frame) both.step(block.reference(frame));
  const SolverState state = both.state();
  other.restore(state);
  for (int frame = 5; frame <= 8; ++frame) {
    const Positions first = both.step(block.reference(frame)), second = other.step(block.reference(frame));
    CHECK(std::memcmp(first.data(), second.data(), sizeof(double) * static_cast<std::size_t>(first.size())) == 0);
  }
  SolverState wrong = state;
  wrong.arrays.back() = Positions::Zero(3, 3);
  both.restore(state);
  CHECK_THROWS_AS(both.restore(wrong), InvalidInput);
  other.restore(state);
  CHECK(both.step(block.reference(5)) == other.step(block.reference(5)));  // untouched by what was refused
  CHECK_THROWS_AS(both.restore({{}, {}}), InvalidInput);
}

TEST_CASE("solvers that do not fit each other are refused") {
  const ShakenBlock block;
  ImplicitEuler corrector = solver(block, 1);
  Guess small(3, 0.0);
  CHECK_THROWS_AS(PredictorCorrector(small, corrector), InvalidInput);
}
