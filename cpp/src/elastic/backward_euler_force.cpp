// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/backward_euler_force.hpp"

#include <algorithm>
#include <cmath>
#include <string>

#include "elastic/element_batch.hpp"
#include "elastic/element_colors.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

// What a tet takes on one core.
constexpr double tet_nanoseconds = 20;

struct Kernels {
  std::uint64_t (*forces)(const SingleBatchConstants*, const ElementRun&, const double*, float, float, float*) noexcept;
  void (*mass)(const float*, const ElementRun&, const float*, float*) noexcept;
};

Kernels kernels() {
  return {FOLLOWTHROUGH_KERNEL_OF_TYPE(decltype(Kernels::forces), cluster_forces),
          FOLLOWTHROUGH_KERNEL_OF_TYPE(decltype(Kernels::mass), cluster_mass)};
}

}  // namespace

BackwardEulerForce::BackwardEulerForce(const ElasticBody& body, double dt, Precision precision)
    : body_(body), square_(dt * dt), precision_(precision) {
  if (!(std::isfinite(dt) && dt > 0)) {
    throw InvalidInput("dt", "found " + std::to_string(dt) + ", expected a finite number above 0");
  }
  const auto count = static_cast<std::size_t>(body.vertex_count());
  positions_.resize(count);
  if (precision == Precision::kDouble) {
    away_.resize(count);
    force_.resize(count);
    return;
  }
  single_away_.resize(count);
  single_force_.resize(count);
  single_masses_.assign(body_.masses_.begin(), body_.masses_.end());
}

BackwardEulerForce::~BackwardEulerForce() = default;

void BackwardEulerForce::add_single_forces() {
  const Kernels kernel = kernels();
  const auto forces = [&](std::size_t, std::size_t first, std::size_t last) {
    const ElementRun run{body_.corners_[first].data(), static_cast<int>(last - first)};
    kernel.mass(&single_masses_[first], run, &single_away_.front().x, &single_force_.front().x);
    const std::uint64_t beyond =
        kernel.forces(&body_.single_batches_[first / single_lanes], run, &positions_.front().x, static_cast<float>(square_),
                      static_cast<float>(InvertibleStVK::smallest_stretch), &single_force_.front().x);
    for (int k = 0; k < run.count && beyond >> k != 0; ++k) {
      if (beyond >> k & 1) body_.add_force(first + static_cast<std::size_t>(k), positions_, material_, square_, single_force_);
    }
  };
  for_clusters(body_.color_starts_, body_.clusters_, body_.elements_.size(), tet_nanoseconds, forces);
}

void BackwardEulerForce::evaluate(ConstPositions positions, ConstPositions inertial) {
  require_rows("positions", positions.rows(), vertex_count());
  require_rows("inertial", inertial.rows(), vertex_count());
  const bool single = precision_ == Precision::kSingle;
  for (std::size_t v = 0; v < positions_.size(); ++v) {
    const auto row = static_cast<Eigen::Index>(v);
    positions_[v] = {positions(row, 0), positions(row, 1), positions(row, 2), 0};
    const Padded<double> away{positions(row, 0) - inertial(row, 0), positions(row, 1) - inertial(row, 1),
                              positions(row, 2) - inertial(row, 2), 0};
    if (single) {
      single_away_[v] = {static_cast<float>(away.x), static_cast<float>(away.y), static_cast<float>(away.z), 0};
      single_force_[v] = {};
    } else {
      away_[v] = away;
      force_[v] = {};
    }
  }
  if (single) {
    add_single_forces();
  } else {
    body_.add_mass_product(away_, force_);
    body_.add_internal_forces(positions_, material_, square_, force_);
  }
}

template <typename Force>
void BackwardEulerForce::write(Force& force) const {
  using Real = typename Force::Scalar;
  const auto copy = [&](const auto& from) {
    for (std::size_t v = 0; v < from.size(); ++v) {
      const auto row = static_cast<Eigen::Index>(v);
      force(row, 0) = static_cast<Real>(from[v].x);
      force(row, 1) = static_cast<Real>(from[v].y);
      force(row, 2) = static_cast<Real>(from[v].z);
    }
  };
  if (precision_ == Precision::kSingle) {
    copy(single_force_);
  } else {
    copy(force_);
  }
}

void BackwardEulerForce::evaluate(ConstPositions positions, ConstPositions inertial, Eigen::Ref<Positions> force) {
  require_rows("force", force.rows(), vertex_count());
  evaluate(positions, inertial);
  write(force);
}

void BackwardEulerForce::evaluate(ConstPositions positions, ConstPositions inertial, Eigen::Ref<SingleForces> force) {
  require_rows("force", force.rows(), vertex_count());
  evaluate(positions, inertial);
  write(force);
}

}  // namespace followthrough
