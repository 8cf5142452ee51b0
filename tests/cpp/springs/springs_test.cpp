// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/springs.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <cmath>
#include <limits>
#include <random>

#include "followthrough/errors.hpp"
#include "followthrough/springs/particle.hpp"
#include "instruction_set.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

constexpr double dt = 1.0 / 24.0;

struct Constants {
  Vector stiffness, damping;
};

Constants random_constants(Eigen::Index count, double low, double high, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> exponent(low, high);
  Constants constants{Vector(count), Vector(count)};
  for (Eigen::Index v = 0; v < count; ++v) {
    constants.stiffness[v] = v % 11 == 0 ? 0.0 : std::pow(10.0, exponent(random));
    constants.damping[v] = v % 13 == 0 ? 0.0 : std::pow(10.0, exponent(random));
  }
  return constants;
}

std::vector<Positions> random_motion(Eigen::Index count, int frames, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> number;
  std::vector<Positions> motion;
  for (int frame = 0; frame < frames; ++frame) {
    motion.push_back(Positions::NullaryExpr(count, 3, [&] { return number(random); }));
  }
  return motion;
}

std::vector<Positions> run(Springs& springs, const std::vector<Positions>& motion) {
  springs.reset(motion[0]);
  std::vector<Positions> result;
  for (std::size_t frame = 1; frame < motion.size(); ++frame) {
    result.push_back(springs.step(motion[frame], frame + 1 < motion.size() ? &motion[frame + 1] : nullptr));
  }
  return result;
}

}  // namespace

TEST_CASE("springs step as the plain particle does, with every instruction set, bit for bit alike") {
  const InstructionSet usual = instruction_set();
  for (const Eigen::Index count : {1, 2, 3, 7, 8, 9, 17, 1000, 5003}) {
    const Constants constants = random_constants(count, -12.0, 12.0, 1);
    const std::vector<Positions> motion = random_motion(count, 6, 2);
    std::vector<Positions> expected;
    std::vector<Particle> particles(static_cast<std::size_t>(count));
    for (std::size_t f = 0; f + 1 < motion.size(); ++f) {
      Positions positions(count, 3);
      for (Eigen::Index v = 0; v < count; ++v) {
        const auto at = [&](std::size_t frame) -> Eigen::Vector3d { return motion[frame].row(v).transpose(); };
        const Eigen::Vector3d one_sided = (at(f + 1) - at(f)) / dt;
        const Eigen::Vector3d slope0 = f > 0 ? Eigen::Vector3d((at(f + 1) - at(f - 1)) / (2.0 * dt)) : one_sided;
        const Eigen::Vector3d slope1 = f + 2 < motion.size() ? Eigen::Vector3d((at(f + 2) - at(f)) / (2.0 * dt)) : one_sided;
        Particle& particle = particles[static_cast<std::size_t>(v)];
        if (f == 0) {
          particle = {at(0), slope0};
        }
        particle = advance(particle, CubicTarget::hermite(at(f), at(f + 1), slope0, slope1, dt), 0.0, dt, constants.stiffness[v],
                           constants.damping[v]);
        positions.row(v) = particle.position.transpose();
      }
      expected.push_back(positions);
    }
    std::vector<Positions> baseline;
    for (const InstructionSet set : available_instruction_sets()) {
      CAPTURE(name_of(set));
      use_instruction_set(set);
      Springs springs(constants.stiffness, constants.damping, dt);
      const std::vector<Positions> result = run(springs, motion);
      if (baseline.empty()) {
        baseline = result;
      }
      for (std::size_t f = 0; f < result.size(); ++f) {
        CHECK((result[f] - expected[f]).cwiseAbs().maxCoeff() < 1e-11);
        CHECK(same_bits(result[f], baseline[f]));
      }
    }
  }
  use_instruction_set(usual);
}

TEST_CASE("springs do not depend on the number of threads") {
  const Eigen::Index count = 200001;  // enough for the work to be shared
  const Constants constants = random_constants(count, -3.0, 6.0, 3);
  const std::vector<Positions> motion = random_motion(count, 4, 4);
  const int usual = omp_get_max_threads();
  std::vector<Positions> first;
  for (const int threads : {1, 2, 4}) {
    omp_set_num_threads(threads);
    Springs springs(constants.stiffness, constants.damping, dt);
    const std::vector<Positions> result = run(springs, motion);
    if (first.empty()) {
      first = result;
    }
    for (std::size_t f = 0; f < result.size(); ++f) {
      CHECK(same_bits(result[f], first[f]));
    }
  }
  omp_set_num_threads(usual);
}

TEST_CASE("cutting a frame into sub-steps of the same cubic changes nothing") {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> exponent(-3.0, 5.0);
  std::normal_distribution<double> number;
  const auto vector = [&] { return Eigen::Vector3d(number(random), number(random), number(random)); };
  for (int trial = 0; trial < 200; ++trial) {
    const double stiffness = std::pow(10.0, exponent(random)), damping = std::pow(10.0, exponent(random) - 1.0);
    const CubicTarget target = CubicTarget::hermite(vector(), vector(), vector(), vector(), dt);
    const Particle start{vector(), vector()};
    const Particle whole = advance(start, target, 0.0, dt, stiffness, damping);
    for (const int steps : {1, 7, 100}) {
      Particle particle = start;
      for (int k = 0; k < steps; ++k) {
        particle = advance(particle, target, dt * k / steps, dt * (k + 1) / steps, stiffness, damping);
      }
      CHECK((particle.position - whole.position).norm() < 1e-10);
      CHECK((particle.velocity - whole.velocity).norm() < 1e-10 * (1.0 + whole.velocity.norm() + std::sqrt(stiffness)));
    }
  }
}

TEST_CASE("the sub-frame curve solves the spring's equation") {
  // Derivatives by central differences of the closed form, at a time where the target curves.
  const CubicTarget target = CubicTarget::hermite({0, 1, 2}, {1, 0, 2}, {3, -4, 1}, {-20, 5, 2}, dt);
  const Particle start{{0.5, 0.5, 0.5}, {1, 2, 3}};
  const double stiffness = 900.0, damping = 11.0, t = 0.4 * dt, h = 1e-5;
  const auto at = [&](double time) { return advance(start, target, 0.0, time, stiffness, damping); };
  const Eigen::Vector3d acceleration = (at(t + h).position - 2.0 * at(t).position + at(t - h).position) / (h * h);
  const Eigen::Vector3d force = stiffness * (target.position(t) - at(t).position) + damping * (target.velocity(t) - at(t).velocity);
  CHECK((acceleration - force).norm() < 1e-5 * force.norm());
  CHECK(((at(t + h).position - at(t - h).position) / (2.0 * h) - at(t).velocity).norm() < 1e-6 * at(t).velocity.norm());
}

TEST_CASE("evaluate runs along the step's curve and changes nothing") {
  const Eigen::Index count = 50;
  const Constants constants = random_constants(count, -2.0, 4.0, 6);
  const std::vector<Positions> motion = random_motion(count, 4, 7);
  Mask pinned = Mask::Zero(count);
  pinned[3] = true;
  Springs springs(constants.stiffness, constants.damping, dt, pinned);
  springs.reset(motion[0]);
  for (std::size_t f = 1; f + 1 < motion.size(); ++f) {
    const SolverState before = springs.state();
    const Positions none = springs.evaluate(0.0, motion[f], &motion[f + 1]), all = springs.evaluate(1.0, motion[f], &motion[f + 1]);
    CHECK((none - before.arrays[0]).cwiseAbs().maxCoeff() < 1e-12);
    CHECK(same_bits(springs.state().arrays[1], before.arrays[1]));
    CHECK((springs.step(motion[f], &motion[f + 1]) - all).cwiseAbs().maxCoeff() < 1e-11);
  }
}

TEST_CASE("pinned vertices follow the reference bit for bit") {
  const Eigen::Index count = 5000;
  const Constants constants = random_constants(count, -12.0, 12.0, 8);
  std::vector<Positions> motion = random_motion(count, 5, 9);
  motion[2].row(4).setConstant(-0.0);
  motion[3].row(4).setConstant(1e300);
  Mask pinned(count);
  for (Eigen::Index v = 0; v < count; ++v) {
    pinned[v] = v % 4 == 0;
  }
  Springs springs(constants.stiffness, constants.damping, dt, pinned);
  const std::vector<Positions> result = run(springs, motion);
  for (std::size_t f = 0; f < result.size(); ++f) {
    for (Eigen::Index v = 0; v < count; v += 4) {
      REQUIRE(same_bits(Positions(result[f].row(v)), Positions(motion[f + 1].row(v))));
    }
  }
}

TEST_CASE("a restored state resumes bit for bit") {
  const Eigen::Index count = 300;
  const Constants constants = random_constants(count, -3.0, 5.0, 10);
  const std::vector<Positions> motion = random_motion(count, 8, 11);
  for (const std::size_t cut : {0u, 1u, 3u}) {
    Springs springs(constants.stiffness, constants.damping, dt), other(constants.stiffness, constants.damping, dt);
    springs.reset(motion[0]);
    for (std::size_t f = 1; f <= cut; ++f) {
      springs.step(motion[f], &motion[f + 1]);
    }
    other.restore(springs.state());
    for (std::size_t f = cut + 1; f + 1 < motion.size(); ++f) {
      CHECK(same_bits(springs.step(motion[f], &motion[f + 1]), other.step(motion[f], &motion[f + 1])));
    }
  }
}

TEST_CASE("its own result may be the next reference") {
  const Eigen::Index count = 30;
  const Constants constants = random_constants(count, 0.0, 3.0, 12);
  const std::vector<Positions> motion = random_motion(count, 3, 13);
  Springs springs(constants.stiffness, constants.damping, dt), other(constants.stiffness, constants.damping, dt);
  springs.reset(motion[0]);
  other.reset(motion[0]);
  const Positions& result = springs.step(motion[1]);
  const Positions copy = other.step(motion[1]);
  CHECK(same_bits(springs.step(result), other.step(copy)));
}

TEST_CASE("a view of a wider array is read by its own rows") {
  const Eigen::Index count = 40;
  const Constants constants = random_constants(count, 0.0, 3.0, 14);
  const std::vector<Positions> motion = random_motion(count, 3, 15);
  Values wide = Values::Constant(count, 5, 77.0);
  wide.leftCols(3) = motion[1];
  Springs springs(constants.stiffness, constants.damping, dt), other(constants.stiffness, constants.damping, dt);
  springs.reset(motion[0]);
  other.reset(motion[0]);
  const Eigen::Map<const Positions, 0, Eigen::OuterStride<>> view(wide.data(), count, 3, Eigen::OuterStride<>(5));
  CHECK(same_bits(springs.step(view), other.step(motion[1])));
}

TEST_CASE("input that cannot be used is refused and changes nothing") {
  const double nan = std::numeric_limits<double>::quiet_NaN(), infinity = std::numeric_limits<double>::infinity();
  const Vector good = Vector::Constant(40, 100.0);
  for (const double bad : {-1.0, nan, infinity}) {
    Vector values = good;
    values[7] = bad;
    CHECK_THROWS_AS(Springs(values, good, dt), InvalidInput);
    CHECK_THROWS_AS(Springs(good, values, dt), InvalidInput);
    CHECK_THROWS_AS(Springs(good, good, bad), InvalidInput);
  }
  CHECK_THROWS_AS(Springs(good, good, 0.0), InvalidInput);
  CHECK_THROWS_AS(Springs(good, Vector::Ones(3), dt), InvalidInput);
  CHECK_THROWS_AS(Springs(good, good, dt, Mask::Zero(3)), InvalidInput);

  Springs springs(good, good, dt);
  const std::vector<Positions> motion = random_motion(40, 3, 16);
  CHECK_THROWS_AS(springs.step(motion[0]), InvalidInput);
  springs.reset(motion[0]);
  springs.step(motion[1]);
  const SolverState before = springs.state();
  for (Eigen::Index row = 0; row < 40; row += 13) {
    for (const double bad : {nan, infinity, -infinity}) {
      Positions broken = motion[2];
      broken(row, row % 3) = bad;
      CHECK_THROWS_AS(springs.reset(broken), InvalidInput);
      CHECK_THROWS_AS(springs.step(broken), InvalidInput);
      CHECK_THROWS_AS(springs.step(motion[2], &broken), InvalidInput);
    }
  }
  CHECK_THROWS_AS(springs.step(Positions::Zero(39, 3)), InvalidInput);
  CHECK_THROWS_AS(springs.restore(SolverState{}), InvalidInput);
  const SolverState after = springs.state();
  CHECK(after.counters == before.counters);
  for (std::size_t k = 0; k < before.arrays.size(); ++k) {
    CHECK(same_bits(after.arrays[k], before.arrays[k]));
  }
}

TEST_CASE("springs rest where gravity and stiffness are even, and pinned vertices do not sag") {
  const Vector stiffness = Vector::LinSpaced(5, 100.0, 3000.0), damping = Vector::Constant(5, 12.0);
  Mask pinned = Mask::Constant(5, false);
  pinned[2] = true;
  const Eigen::Vector3d gravity(0.5, 0.0, -9.81);
  Springs springs(stiffness, damping, dt, pinned, gravity);
  const Positions rest = Positions::Random(5, 3);
  springs.reset(rest);
  Positions settled;
  for (int frame = 0; frame < 240; ++frame) settled = springs.step(rest, &rest);
  for (Eigen::Index v = 0; v < 5; ++v) {
    if (pinned[v]) {
      CHECK(settled.row(v) == rest.row(v));
    } else {
      CHECK((settled.row(v) - rest.row(v) - gravity.transpose() / stiffness[v]).norm() < 1e-9);
    }
  }
}

TEST_CASE("gravity adds its own motion to springs, and nothing else") {
  const std::vector<Positions> motion = random_motion(40, 8, 3);
  Vector stiffness = Vector::LinSpaced(40, 50.0, 5000.0), damping = Vector::LinSpaced(40, 0.0, 90.0);
  const Eigen::Vector3d gravity(0.0, 3.0, -9.81);
  Springs plain(stiffness, damping, dt), heavy(stiffness, damping, dt, Mask(), gravity),
      still(stiffness, damping, dt, Mask(), gravity);
  const std::vector<Positions> without = run(plain, motion), with = run(heavy, motion);
  const Positions origin = Positions::Zero(40, 3);
  still.reset(origin);
  for (std::size_t k = 0; k < with.size(); ++k) {
    CHECK((with[k] - without[k] - still.step(origin, &origin)).cwiseAbs().maxCoeff() < 1e-11);
  }
  heavy.reset(motion[0]);
  heavy.step(motion[1], &motion[2]);
  const Positions ahead = heavy.evaluate(1.0, motion[2], &motion[3]);
  CHECK((ahead - heavy.step(motion[2], &motion[3])).cwiseAbs().maxCoeff() < 1e-11);
  stiffness[7] = 0.0;
  CHECK_THROWS_AS(Springs(stiffness, damping, dt, Mask(), gravity), InvalidInput);
  CHECK_THROWS_AS(Springs(stiffness, damping, dt, Mask(), {0.0, std::nan(""), 0.0}), InvalidInput);
}
