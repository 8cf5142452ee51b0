// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/quasistatic/quasistatic.hpp"

#include <cmath>
#include <string>
#include <utility>

#include "followthrough/errors.hpp"
#include "mesh/disjoint_sets.hpp"
#include "quasistatic/equilibrium_search.hpp"

namespace followthrough {
namespace {

// Stiffness, beside its own at rest, of the springs to the reference that a vertex has in a part of the body that nothing holds.
constexpr double loose_hold = 1e-5;

void require_valid(const EquilibriumSettings& settings, const StaticForces& forces, Eigen::Index count) {
  if (!(std::isfinite(settings.tolerance) && settings.tolerance > 0)) {
    throw InvalidInput("tolerance", "found " + std::to_string(settings.tolerance) + ", expected a finite number above 0");
  }
  require_finite("gravity", forces.gravity.transpose());
  if (forces.pin_stiffness.size() == 0) return;
  require_rows("pin_stiffness", forces.pin_stiffness.size(), count);
  for (const double stiffness : forces.pin_stiffness) {
    if (!(std::isfinite(stiffness) && stiffness >= 0)) {
      throw InvalidInput("pin_stiffness", "found " + std::to_string(stiffness) + ", expected a finite number, 0 or more");
    }
  }
}

// Vertices of parts, joined by tets, in which none is constrained or pinned.
std::vector<bool> loose_vertices(const ElasticBody& body, ConstMask constrained, const StaticForces& forces) {
  DisjointSets parts(static_cast<std::size_t>(body.vertex_count()));
  for (const auto& corners : body.corners()) {
    for (int k = 1; k < 4; ++k) parts.join(corners[0], corners[k]);
  }
  std::vector<bool> loose(static_cast<std::size_t>(body.vertex_count()), true);
  for (Index v = 0; v < body.vertex_count(); ++v) {
    if (constrained[v] || (forces.pin_stiffness.size() > 0 && forces.pin_stiffness[v] > 0)) loose[parts.find(v)] = false;
  }
  for (Index v = 0; v < body.vertex_count(); ++v) loose[v] = loose[parts.find(v)];
  return loose;
}

EquilibriumProblem pose_problem(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained,
                                const EquilibriumSettings& settings, const StaticForces& forces) {
  const Eigen::Index count = body.vertex_count();
  require_rows("constrained", constrained.size(), count);
  require_valid(settings, forces, count);
  std::vector<Index> rows(static_cast<std::size_t>(count), -1), free;
  Mask moves = Mask::Constant(count, false);
  for (Eigen::Index v = 0; v < count; ++v) {
    if (constrained[v] || body.lumped_mass()[v] == 0) continue;
    rows[v] = static_cast<Index>(free.size());
    free.push_back(static_cast<Index>(v));
    moves[v] = true;
  }
  if (free.empty()) throw InvalidInput("constrained", "found no free vertex, expected at least one");

  ElasticBody around = body.around(moves);
  const std::vector<bool> loose_vertex = loose_vertices(around, constrained, forces);
  const Vector alone = around.rest_stiffness();
  BlockMatrix pins(around.corners(), rows);
  StaticForces all = forces;
  if (all.pin_stiffness.size() == 0) all.pin_stiffness.setZero(count);
  Vector rest_stiffness(static_cast<Eigen::Index>(free.size()));
  for (Eigen::Index row = 0; row < rest_stiffness.size(); ++row) {
    const Index v = free[row];
    if (loose_vertex[v] && !forces.gravity.isZero(0)) {
      throw InvalidInput("constrained", "found vertex " + std::to_string(v) +
                                            " in a part of the body that nothing holds, expected a constrained vertex or a soft "
                                            "pin in every part: gravity leaves the others without an equilibrium");
    }
    double& pin = all.pin_stiffness[v];
    if (loose_vertex[v]) pin = loose_hold * alone[v];
    rest_stiffness[row] = alone[v] + pin;
    pins.add_to_diagonal(row, pin * BlockMatrix::Block::Identity());
  }
  BlockMatrix matrix = pins;
  SparseCholesky factor(pins);
  return {std::move(around),
          std::move(material),
          settings,
          std::move(all),
          std::move(rows),
          std::move(free),
          std::move(rest_stiffness),
          std::move(pins),
          std::move(matrix),
          std::move(factor),
          {}};
}

}  // namespace

struct Quasistatic::Parts {
  EquilibriumProblem problem;
  Positions equilibrium, reference;  // of the last pose; no rows: none
  StepReport report;
};

Quasistatic::Quasistatic(const ElasticBody& body, std::shared_ptr<const Material> material, ConstMask constrained,
                         const EquilibriumSettings& settings, const StaticForces& forces)
    : parts_(new Parts{pose_problem(body, std::move(material), constrained, settings, forces), {}, {}, {}}) {}

Quasistatic::~Quasistatic() = default;
Quasistatic::Quasistatic(Quasistatic&&) noexcept = default;
Quasistatic& Quasistatic::operator=(Quasistatic&&) noexcept = default;

Eigen::Index Quasistatic::vertex_count() const { return parts_->problem.body.vertex_count(); }
const StepReport& Quasistatic::last_solve() const { return parts_->report; }
const Positions& Quasistatic::last_reference() const { return parts_->reference; }
const Positions& Quasistatic::last_equilibrium() const { return parts_->equilibrium; }

void Quasistatic::forget() { start_from(Positions(0, 3), Positions(0, 3)); }

void Quasistatic::start_from(ConstPositions equilibrium, ConstPositions reference) {
  const Eigen::Index expected = equilibrium.rows() == 0 ? 0 : vertex_count();
  require_rows("equilibrium", equilibrium.rows(), expected);
  require_rows("reference", reference.rows(), expected);
  require_finite("equilibrium", equilibrium);
  require_finite("reference", reference);
  parts_->equilibrium = equilibrium;
  parts_->reference = reference;
  parts_->report = {};
}

const Positions& Quasistatic::solve(ConstPositions reference) {
  require_rows("reference", reference.rows(), vertex_count());
  require_finite("reference", reference);
  Positions carried;
  const bool warm = parts_->equilibrium.rows() > 0;
  if (warm) carried = parts_->equilibrium + reference - parts_->reference;
  Positions found = find_equilibrium(parts_->problem, reference, warm ? &carried : nullptr, parts_->report);
  parts_->equilibrium = found.allFinite() ? std::move(found) : Positions(reference);
  parts_->reference = reference;
  return parts_->equilibrium;
}

}  // namespace followthrough
