// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_fit.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>

#include "followthrough/errors.hpp"
#include "followthrough/springs/springs.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

constexpr double dt = 1.0 / 24.0;

struct Motion {
  Values reference, dynamic;
};

// Waves of several frequencies, of their own on every axis of every vertex.
Values smooth_reference(Eigen::Index frames, Eigen::Index vertices, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> number;
  std::uniform_real_distribution<double> share;
  Values reference = Values::Zero(frames, 3 * vertices);
  for (Eigen::Index column = 0; column < 3 * vertices; ++column) {
    for (int wave = 0; wave < 4; ++wave) {
      const double size = 0.1 * number(random), rate = 1.0 + 12.0 * share(random), phase = 6.0 * share(random);
      for (Eigen::Index frame = 0; frame < frames; ++frame) {
        reference(frame, column) += size * std::sin(rate * dt * static_cast<double>(frame) + phase);
      }
    }
  }
  return reference;
}

Values simulated(const Values& reference, const Vector& stiffness, const Vector& damping) {
  const Eigen::Index vertices = stiffness.size();
  const auto frame = [&](Eigen::Index f) { return Positions(Eigen::Map<const Positions>(reference.row(f).data(), vertices, 3)); };
  Springs springs(stiffness, damping, dt);
  Values dynamic = reference;
  springs.reset(frame(0));
  for (Eigen::Index f = 1; f < reference.rows(); ++f) {
    const Positions next = f + 1 < reference.rows() ? frame(f + 1) : Positions();
    const Positions& now = springs.step(frame(f), f + 1 < reference.rows() ? &next : nullptr);
    dynamic.row(f) = Eigen::Map<const Eigen::RowVectorXd>(now.data(), 3 * vertices);
  }
  return dynamic;
}

struct Synthetic {
  Vector stiffness, damping, ratio;
  Motion motion;
};

// Stiffness from 10 to 1e4, and from far under- to far overdamped.
Synthetic synthetic(Eigen::Index vertices, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<double> share;
  Synthetic made{Vector(vertices), Vector(vertices), Vector(vertices), {}};
  for (Eigen::Index v = 0; v < vertices; ++v) {
    made.stiffness[v] = std::pow(10.0, 1.0 + 3.0 * share(random));
    made.ratio[v] = v % 5 == 0 ? 1.0 : std::pow(10.0, -1.7 + 3.0 * share(random));
    made.damping[v] = 2.0 * made.ratio[v] * std::sqrt(made.stiffness[v]);
  }
  made.motion.reference = smooth_reference(100, vertices, seed + 1);
  made.motion.dynamic = simulated(made.motion.reference, made.stiffness, made.damping);
  return made;
}

double worst_error(const SpringFit& fit, const Synthetic& truth) {
  double worst = 0.0;
  for (Eigen::Index v = 0; v < truth.stiffness.size(); ++v) {
    worst =
        std::max({worst, std::abs(fit.stiffness[v] / truth.stiffness[v] - 1.0), std::abs(fit.damping[v] / truth.damping[v] - 1.0)});
  }
  return worst;
}

SpringFit fit(const Motion& motion, const SpringFitSettings& settings = {}, ConstMask skipped = Mask()) {
  const SpringTraining training[] = {{motion.reference, motion.dynamic, dt}};
  return fit_springs(training, skipped, 0, motion.reference.cols() / 3, settings);
}

std::string message_of(const auto& work) {
  try {
    work();
  } catch (const InvalidInput& problem) {
    return problem.what();
  }
  return "";
}

}  // namespace

TEST_CASE("the true constants come back within one percent, whatever the damping") {
  const Synthetic truth = synthetic(300, 1);
  const SpringFit found = fit(truth.motion);
  CHECK(worst_error(found, truth) < 0.01);
  CHECK((found.status.array() == static_cast<Index>(SpringFitStatus::fitted)).all());
  CHECK((found.loss.array() < 1e-4 * found.reference_loss.array()).all());
  SpringFitSettings exact;
  exact.regularization = 0.0;
  CHECK(worst_error(fit(truth.motion, exact), truth) < 1e-4);
}

TEST_CASE("with one frame in ten corrupted the robust fit comes within five percent, and the plain one does not") {
  Synthetic truth = synthetic(200, 2);
  std::mt19937 random(3);
  std::normal_distribution<double> number;
  for (Eigen::Index v = 0; v < 200; ++v) {
    const auto lags = (truth.motion.dynamic.middleCols(3 * v, 3) - truth.motion.reference.middleCols(3 * v, 3)).eval();
    const double size = std::sqrt(lags.squaredNorm() / 300.0);
    for (int k = 0; k < 10; ++k) {
      const Eigen::Index frame = 1 + 9 * k + static_cast<Eigen::Index>(random() % 9);
      for (int axis = 0; axis < 3; ++axis) {
        truth.motion.dynamic(frame, 3 * v + axis) += 2.0 * size * number(random);
      }
    }
  }
  SpringFitSettings robust;
  robust.dropped_share = 0.1;
  CHECK(worst_error(fit(truth.motion, robust), truth) < 0.05);
  const SpringFit plain = fit(truth.motion);
  int off = 0;
  for (Eigen::Index v = 0; v < 200; ++v) {
    off += std::abs(plain.stiffness[v] / truth.stiffness[v] - 1.0) > 0.05 ||
           std::abs(plain.damping[v] / truth.damping[v] - 1.0) > 0.05;
  }
  CHECK(off > 50);
}

TEST_CASE("the fit depends on neither threads, nor other vertices, nor how they are cut into parts") {
  const Synthetic truth = synthetic(64, 4);
  const int usual = omp_get_max_threads();
  omp_set_num_threads(1);
  const SpringFit one = fit(truth.motion);
  for (const int threads : {2, 4}) {
    omp_set_num_threads(threads);
    const SpringFit found = fit(truth.motion);
    CHECK(same_bits(found.stiffness, one.stiffness));
    CHECK(same_bits(found.damping, one.damping));
  }
  omp_set_num_threads(usual);
  const SpringTraining training[] = {{truth.motion.reference, truth.motion.dynamic, dt}};
  const SpringFit part = fit_springs(training, Mask(), 20, 13);
  CHECK(same_bits(part.stiffness, one.stiffness.segment(20, 13)));
  CHECK(same_bits(part.damping, one.damping.segment(20, 13)));
}

TEST_CASE("regularization shrinks motion that springs cannot describe, and only that") {
  Synthetic truth = synthetic(100, 5);
  const double size = (truth.motion.dynamic - truth.motion.reference).norm();
  SpringFitSettings strong, none;
  strong.regularization = 3.0;
  none.regularization = 0.0;
  CHECK(worst_error(fit(truth.motion, strong), truth) < 0.01);
  std::mt19937 random(6);
  std::normal_distribution<double> number(0.0, size / std::sqrt(static_cast<double>(truth.motion.dynamic.size())));
  truth.motion.dynamic.bottomRows(99) += Values::NullaryExpr(99, 300, [&] { return number(random); });
  const auto motion_of = [&](const SpringFitSettings& settings) {
    const SpringFit found = fit(truth.motion, settings);
    return (simulated(truth.motion.reference, found.stiffness, found.damping) - truth.motion.reference).norm();
  };
  CHECK(motion_of(strong) < 0.8 * motion_of(none));
}

TEST_CASE("springs are never worse than none where they were learned") {
  Synthetic noise = synthetic(200, 15);
  std::mt19937 random(16);
  std::normal_distribution<double> number(0.0, 0.1);
  noise.motion.dynamic = noise.motion.reference + Values::NullaryExpr(100, 600, [&] { return number(random); });
  const SpringFit found = fit(noise.motion);
  CHECK((found.loss.array() <= found.reference_loss.array() * 1.001).all());
}

TEST_CASE("several motions are learned from together") {
  const Synthetic truth = synthetic(50, 6);
  const Values other = smooth_reference(40, 50, 99);
  const Values other_dynamic = simulated(other, truth.stiffness, truth.damping);
  const SpringTraining both[] = {{truth.motion.reference, truth.motion.dynamic, dt}, {other, other_dynamic, dt}};
  const SpringFit found = fit_springs(both, Mask(), 0, 50);
  CHECK(worst_error(found, truth) < 0.01);
  const SpringTraining first[] = {both[0]}, second[] = {both[1]};
  const Vector sum = spring_loss(first, truth.stiffness, Vector::Constant(50, 9.0)).loss +
                     spring_loss(second, truth.stiffness, Vector::Constant(50, 9.0)).loss;
  CHECK((spring_loss(both, truth.stiffness, Vector::Constant(50, 9.0)).loss - sum).cwiseAbs().maxCoeff() < 1e-12 * sum.maxCoeff());
}

TEST_CASE("the loss is what the springs themselves leave") {
  const Synthetic truth = synthetic(20, 7);
  const Vector stiffness = Vector::LinSpaced(20, 1.0, 5e3), damping = Vector::LinSpaced(20, 200.0, 0.0);
  const Values run = simulated(truth.motion.reference, stiffness, damping);
  const SpringTraining training[] = {{truth.motion.reference, truth.motion.dynamic, dt}};
  const SpringLoss found = spring_loss(training, stiffness, damping);
  for (Eigen::Index v = 0; v < 20; ++v) {
    CHECK(found.loss[v] == doctest::Approx((run - truth.motion.dynamic).middleCols(3 * v, 3).squaredNorm()).epsilon(1e-9));
  }
}

TEST_CASE("vertices that say nothing have defined constants") {
  Synthetic truth = synthetic(6, 8);
  Values& reference = truth.motion.reference;
  Values& dynamic = truth.motion.dynamic;
  reference.middleCols(0, 3).setConstant(3.0);  // stands still, whatever is around it
  dynamic.middleCols(0, 3).setConstant(3.0);
  for (Eigen::Index frame = 0; frame < reference.rows(); ++frame) {  // moves evenly
    reference.row(frame).segment(3, 3).setConstant(0.1 * static_cast<double>(frame) - 7.0);
  }
  dynamic.middleCols(3, 3) = reference.middleCols(3, 3);
  dynamic.middleCols(6, 3) = reference.middleCols(6, 3);  // moves, and never leaves its reference
  Mask skipped = Mask::Zero(6);
  skipped[3] = true;
  const SpringFit found = fit(truth.motion, {}, skipped);
  const auto status = [&](Eigen::Index v) { return static_cast<SpringFitStatus>(found.status[v]); };
  CHECK(status(0) == SpringFitStatus::unmoved);
  CHECK(status(1) == SpringFitStatus::unmoved);
  CHECK(status(2) == SpringFitStatus::rigid);
  CHECK(status(3) == SpringFitStatus::skipped);
  CHECK(status(4) == SpringFitStatus::fitted);
  for (const Eigen::Index v : {0, 1, 3}) {
    CHECK(found.stiffness[v] == usual_stiffness);
    CHECK(found.damping[v] == usual_damping);
  }
  CHECK(found.stiffness[2] * dt * dt > 100.0);
  CHECK(found.damping[2] * found.damping[2] == doctest::Approx(4.0 * found.stiffness[2]));
  CHECK(found.stiffness[4] == doctest::Approx(truth.stiffness[4]).epsilon(0.01));
}

TEST_CASE("input that cannot be learned from is refused by name") {
  Synthetic truth = synthetic(5, 9);
  const auto fitted = [&](SpringFitSettings settings = {}) { return message_of([&] { fit(truth.motion, settings); }); };
  truth.motion.dynamic(7, 3 * 2 + 1) = std::numeric_limits<double>::quiet_NaN();
  const std::string broken = fitted();
  CHECK(broken.find("dynamic") != std::string::npos);
  CHECK(broken.find("frame 7, vertex 2") != std::string::npos);
  truth.motion.dynamic(7, 3 * 2 + 1) = 0.0;
  CHECK(fitted().empty());
  SpringFitSettings settings;
  settings.regularization = -1.0;
  CHECK(fitted(settings).find("regularization") != std::string::npos);
  settings = {};
  settings.dropped_share = 1.0;
  CHECK(fitted(settings).find("dropped_share") != std::string::npos);
  settings = {};
  settings.population = 3;
  CHECK(fitted(settings).find("population") != std::string::npos);
  const Values still = truth.motion.reference.topRows(1);
  const SpringTraining one_frame[] = {{still, still, dt}};
  CHECK(message_of([&] { fit_springs(one_frame, Mask(), 0, 5); }).find("two or more") != std::string::npos);
  const Values shorter = truth.motion.reference.topRows(20);
  const SpringTraining uneven[] = {{truth.motion.reference, shorter, dt}};
  CHECK(message_of([&] { fit_springs(uneven, Mask(), 0, 5); }).find("dynamic") != std::string::npos);
  const SpringTraining no_time[] = {{truth.motion.reference, truth.motion.dynamic, 0.0}};
  CHECK(message_of([&] { fit_springs(no_time, Mask(), 0, 5); }).find("dt") != std::string::npos);
  CHECK(message_of([&] { fit_springs({}, Mask(), 0, 0); }).find("motions") != std::string::npos);
  const SpringTraining sound[] = {{truth.motion.reference, truth.motion.dynamic, dt}};
  CHECK(message_of([&] { fit_springs(sound, Mask(), 3, 3); }).find("first") != std::string::npos);
  CHECK(message_of([&] { fit_springs(sound, Mask::Zero(4), 0, 5); }).find("skipped") != std::string::npos);
}

TEST_CASE("two frames are enough to get an answer") {
  const Synthetic truth = synthetic(10, 10);
  const Motion two{truth.motion.reference.topRows(2), truth.motion.dynamic.topRows(2)};
  const SpringFit found = fit(two);
  CHECK(found.stiffness.allFinite());
  CHECK(found.damping.allFinite());
}
