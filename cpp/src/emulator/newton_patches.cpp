// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/newton_patches.hpp"

#include <cstddef>
#include <string>
#include <utility>

#include "emulator/newton_problem.hpp"
#include "emulator/step_guard.hpp"
#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

void require_evaluated(const NewtonProblem& problem) {
  if (!problem.evaluated) throw InvalidInput("estimate", "found none that was evaluated, expected begin and evaluate before this");
}

PatchFeatures features_of(const NewtonProblem& p, const GuideInputs& inputs) {
  PatchFeatures result;
  result.vectors.resize(p.free_count, 3 * Eigen::Index{inputs.vector_count});
  result.scalars.resize(p.free_count, inputs.scalar_count);
  for (Eigen::Index v = 0; v < inputs.vector_count; ++v) {
    for (Eigen::Index k = 0; k < 3; ++k) {
      result.vectors.col(3 * v + k) = Eigen::Map<const Eigen::VectorXf>(inputs.vectors[v] + k * p.padded, p.free_count);
    }
  }
  for (Eigen::Index k = 0; k < inputs.scalar_count; ++k) {
    result.scalars.col(k) = Eigen::Map<const Eigen::VectorXf>(inputs.scalars[k], p.free_count);
  }
  return result;
}

}  // namespace

struct NewtonPatches::Parts {
  explicit Parts(const NewtonBody& body) : problem(body), guard(problem) {}

  NewtonProblem problem;
  StepGuard guard;
};

GuideSize start_guide_size() { return {kStartVectors, kStartScalars}; }
GuideSize pass_guide_size() { return {kPassVectors, kPassScalars}; }

NewtonPatches::NewtonPatches(const NewtonBody& body) : parts_(std::make_unique<Parts>(body)) {}
NewtonPatches::~NewtonPatches() = default;
NewtonPatches::NewtonPatches(NewtonPatches&&) noexcept = default;
NewtonPatches& NewtonPatches::operator=(NewtonPatches&&) noexcept = default;

Eigen::Index NewtonPatches::vertex_count() const { return parts_->problem.count; }
double NewtonPatches::edge_length() const { return parts_->problem.edge_length; }
const Vector& NewtonPatches::stiffness() const { return parts_->problem.stiffness; }
const std::vector<Index>& NewtonPatches::free_vertices() const { return parts_->problem.free_vertices; }
const std::vector<Index>& NewtonPatches::edge_starts() const { return parts_->problem.edge_starts; }
const std::vector<Index>& NewtonPatches::neighbours() const { return parts_->problem.edge_vertices; }

void NewtonPatches::begin(const NewtonHistory& history) {
  for (std::size_t k = 0; k < 4; ++k) {
    const std::string place = "[" + std::to_string(k) + "]";
    for (const auto& [name, positions] :
         {std::pair{"dynamic", &history.dynamic[k]}, std::pair{"reference", &history.reference[k]}}) {
      require_rows((name + place).c_str(), positions->rows(), parts_->problem.count);
      require_finite((name + place).c_str(), *positions);
    }
  }
  parts_->problem.begin(history);
  parts_->guard.begin();
}

PatchFeatures NewtonPatches::start_features() {
  if (!parts_->problem.began) throw InvalidInput("estimate", "found none, expected begin before this");
  return features_of(parts_->problem, parts_->problem.describe_start());
}

double NewtonPatches::evaluate(int iterations) {
  if (!parts_->problem.began) throw InvalidInput("estimate", "found none, expected begin before evaluate");
  if (iterations < 0) throw InvalidInput("iterations", "found " + std::to_string(iterations) + ", expected 0 or more");
  const double left = parts_->guard.evaluate();
  parts_->problem.solve(parts_->guard.iterations(iterations), parts_->guard.tolerance());
  return left;
}

PatchFeatures NewtonPatches::features() {
  require_evaluated(parts_->problem);
  return features_of(parts_->problem, parts_->problem.describe_pass());
}

NewtonPatches::Steps NewtonPatches::direction() const {
  const NewtonProblem& p = parts_->problem;
  require_evaluated(p);
  Steps steps(p.free_count, 3);
  for (Eigen::Index k = 0; k < 3; ++k)
    steps.col(k) = Eigen::Map<const Eigen::VectorXf>(p.solution.data() + k * p.padded, p.free_count);
  return steps;
}

void NewtonPatches::move(const Steps& step, bool last) {
  if (!parts_->problem.began) throw InvalidInput("estimate", "found none, expected begin before move");
  require_rows("step", step.rows(), parts_->problem.free_count);
  if (!step.allFinite()) throw InvalidInput("step", "found NaN or infinity, expected finite numbers");
  NewtonProblem& p = parts_->problem;
  if (p.evaluated) parts_->guard.before_step(true, last);
  for (Eigen::Index k = 0; k < 3; ++k) Eigen::Map<Eigen::VectorXf>(p.steps.data() + k * p.padded, p.free_count) = step.col(k);
  p.move(p.steps.data(), p.evaluated);
}

bool NewtonPatches::end_passes() {
  require_evaluated(parts_->problem);
  parts_->guard.end();
  return parts_->guard.go_to_better_reference();
}

Positions NewtonPatches::estimate() const {
  if (!parts_->problem.began) throw InvalidInput("estimate", "found none, expected begin before this");
  Positions positions(parts_->problem.count, 3);
  parts_->problem.write_estimate(positions);
  return positions;
}

}  // namespace followthrough
