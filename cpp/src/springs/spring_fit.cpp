// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/spring_fit.hpp"

#include <omp.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include "followthrough/errors.hpp"
#include "springs/constants_search.hpp"
#include "springs/vertex_motion.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

// Sums of squares below these shares are what rounding leaves: of the way that the reference makes, and of its distance from the
// origin, where numbers are coarser.
constexpr double still_share = 1e-16;     // squared: 1e-8 of the way
constexpr double rounding_share = 1e-26;  // squared: 1e-13 of the distance
// ks dt^2 of a vertex that never leaves its reference: a frame's lag is then below a thousandth of what the target accelerates in
// it.
constexpr double rigid_rate = 1e3;
// The pull to the usual constants beside the pull to less motion: the best of 0 to 0.1 on motions that were not learned from.
constexpr double pull_of_share = 0.03;
constexpr double least_regularization = 1e-8;
// Nanoseconds a step of one vertex, for worthwhile_threads.
constexpr double fit_cost = 3000, loss_cost = 30;

std::string place(std::size_t motion, Eigen::Index row, Eigen::Index column) {
  return "in motion " + std::to_string(motion) + ", frame " + std::to_string(row) + ", vertex " + std::to_string(column / 3);
}

void require_finite_motion(const char* name, std::size_t index, ConstValues values) {
  for (Eigen::Index row = 0; row < values.rows(); ++row) {
    if (!values.row(row).allFinite()) {
      Eigen::Index column = 0;
      while (std::isfinite(values(row, column))) {
        ++column;
      }
      throw InvalidInput(name, "found " + std::to_string(values(row, column)) + " " + place(index, row, column) +
                                   ", expected finite positions (leave those frames out)");
    }
  }
}

Eigen::Index checked_vertex_count(std::span<const SpringTraining> motions) {
  if (motions.empty()) {
    throw InvalidInput("motions", "found none, expected one or more");
  }
  const Eigen::Index columns = motions[0].reference.cols();
  for (std::size_t m = 0; m < motions.size(); ++m) {
    const SpringTraining& motion = motions[m];
    const std::string in_motion = " in motion " + std::to_string(m);
    if (motion.reference.cols() != columns || columns % 3 != 0) {
      throw InvalidInput("reference", "found " + std::to_string(motion.reference.cols()) + " columns" + in_motion + ", expected " +
                                          std::to_string(columns / 3 * 3) + ", three a vertex");
    }
    if (motion.dynamic.rows() != motion.reference.rows() || motion.dynamic.cols() != columns) {
      throw InvalidInput("dynamic", "found " + std::to_string(motion.dynamic.rows()) + " rows of " +
                                        std::to_string(motion.dynamic.cols()) + in_motion + ", expected as many as reference has");
    }
    if (motion.reference.rows() < 2) {
      throw InvalidInput("reference", "found " + std::to_string(motion.reference.rows()) + " frame" + in_motion +
                                          ", expected two or more: nothing can be learned from a still");
    }
    if (!(std::isfinite(motion.dt) && motion.dt > 0.0)) {
      throw InvalidInput("dt", "found " + std::to_string(motion.dt) + in_motion + ", expected a positive number of seconds");
    }
    require_finite_motion("reference", m, motion.reference);
    require_finite_motion("dynamic", m, motion.dynamic);
  }
  return columns / 3;
}

void require_settings(const SpringFitSettings& settings) {
  if (!(std::isfinite(settings.regularization) && settings.regularization >= 0.0)) {
    throw InvalidInput("regularization",
                       "found " + std::to_string(settings.regularization) + ", expected a finite number, 0 or more");
  }
  if (!(settings.dropped_share >= 0.0 && settings.dropped_share <= 0.9)) {
    throw InvalidInput("dropped_share", "found " + std::to_string(settings.dropped_share) + ", expected 0 to 0.9");
  }
  if (settings.population < 4) {
    throw InvalidInput("population", "found " + std::to_string(settings.population) + ", expected 4 or more");
  }
  if (settings.generations < 1) {
    throw InvalidInput("generations", "found " + std::to_string(settings.generations) + ", expected 1 or more");
  }
}

double shortest_frame(std::span<const SpringTraining> motions) {
  double dt = motions[0].dt;
  for (const SpringTraining& motion : motions) {
    dt = std::min(dt, motion.dt);
  }
  return dt;
}

struct VertexFit {
  double stiffness, damping, loss, reference_loss;
  SpringFitStatus status;
};

// Weight 0 for the share of frames with the greatest error, 1 for the others.
void drop_worst(const std::vector<double>& errors, double share, std::vector<double>& weights) {
  const auto count = static_cast<std::size_t>(std::ceil(share * static_cast<double>(errors.size())));
  std::vector<std::size_t> order(errors.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return errors[a] > errors[b]; });
  weights.assign(errors.size(), 1.0);
  // At least two frames are left: as many as there are unknowns.
  for (std::size_t i = 0; i < count && i + 2 < order.size(); ++i) {
    weights[order[i]] = 0.0;
  }
}

double loss_of(const VertexMotion& motion, const Found& found) {
  return motion.loss(std::exp(found.constants[0]), std::exp(found.constants[1]));
}

// Holds back what the best constants cannot explain (SpringFitSettings::regularization).
Found regularized(VertexMotion& motion, const Found& found, double regularization, const LogConstants& rigid) {
  const double nothing = motion.weight_of_wanted();
  const double share = regularization * loss_of(motion, found) / nothing;
  if (!(share > least_regularization)) {
    return found;
  }
  motion.scale_wanted(1.0 / (1.0 + share));
  // The pull may cost more than springs bring at all, where they bring little; less motion alone hardly ever does.
  for (const double pull : {pull_of_share * share, 0.0}) {
    const Found held_back = pulled_constants(motion, found, pull);
    motion.scale_wanted(1.0 + share);
    if (loss_of(motion, held_back) < nothing) {
      return held_back;
    }
    motion.scale_wanted(1.0 / (1.0 + share));
  }
  return {rigid, nothing};
}

VertexFit fit_vertex(std::span<const SpringTraining> motions, Eigen::Index vertex, const SpringFitSettings& settings, double dt,
                     VertexMotion& motion) {
  motion.read(motions, vertex);
  VertexFit fit{usual_stiffness, usual_damping, motion.lag(), motion.lag(), SpringFitStatus::fitted};
  const double nothing = std::max(still_share * motion.extent(), rounding_share * (motion.extent() + motion.size()));
  if (motion.excitation() <= nothing) {
    fit.status = SpringFitStatus::unmoved;
    return fit;
  }
  const double rigid_stiffness = rigid_rate / (dt * dt), rigid_damping = 2.0 * std::sqrt(rigid_stiffness);
  if (motion.lag() <= nothing) {
    fit.status = SpringFitStatus::rigid;
    fit.stiffness = rigid_stiffness;
    fit.damping = rigid_damping;
  } else {
    const VertexRandom random(settings.seed, static_cast<std::uint64_t>(vertex));
    Found found = search_constants(motion, dt, settings, random, nullptr);
    if (settings.dropped_share > 0.0) {
      std::vector<double> errors;
      motion.squared_errors(std::exp(found.constants[0]), std::exp(found.constants[1]), errors);
      drop_worst(errors, settings.dropped_share, motion.weights());
      found = search_constants(motion, dt, settings, random, &found.constants);
    }
    found = regularized(motion, found, settings.regularization, {std::log(rigid_stiffness), std::log(rigid_damping)});
    fit.stiffness = std::exp(found.constants[0]);
    fit.damping = std::exp(found.constants[1]);
  }
  motion.read(motions, vertex);
  fit.loss = motion.loss(fit.stiffness, fit.damping);
  return fit;
}

double step_count(std::span<const SpringTraining> motions) {
  double steps = 0.0;
  for (const SpringTraining& motion : motions) {
    steps += static_cast<double>(motion.reference.rows() - 1);
  }
  return steps;
}

}  // namespace

SpringFit fit_springs(std::span<const SpringTraining> motions, ConstMask skipped, Eigen::Index first, Eigen::Index count,
                      const SpringFitSettings& settings) {
  const Eigen::Index vertices = checked_vertex_count(motions);
  require_settings(settings);
  if (skipped.size() != 0) {
    require_rows("skipped", skipped.size(), vertices);
  }
  if (first < 0 || count < 0 || first + count > vertices) {
    throw InvalidInput("first", "found vertices " + std::to_string(first) + " to " + std::to_string(first + count) +
                                    ", expected some of " + std::to_string(vertices));
  }
  SpringFit fit{Vector(count), Vector(count), Vector(count), Vector(count), Indices(count)};
  const double dt = shortest_frame(motions);
#pragma omp parallel num_threads(worthwhile_threads(count, fit_cost* step_count(motions)))
  {
    VertexMotion motion;
#pragma omp for schedule(dynamic, 8)
    for (Eigen::Index i = 0; i < count; ++i) {
      VertexFit one{};
      if (skipped.size() != 0 && skipped[first + i]) {
        one = {usual_stiffness, usual_damping, 0.0, 0.0, SpringFitStatus::skipped};
      } else {
        one = fit_vertex(motions, first + i, settings, dt, motion);
      }
      fit.stiffness[i] = one.stiffness;
      fit.damping[i] = one.damping;
      fit.loss[i] = one.loss;
      fit.reference_loss[i] = one.reference_loss;
      fit.status[i] = static_cast<Index>(one.status);
    }
  }
  return fit;
}

SpringLoss spring_loss(std::span<const SpringTraining> motions, ConstVector stiffness, ConstVector damping) {
  const Eigen::Index vertices = checked_vertex_count(motions);
  require_rows("stiffness", stiffness.size(), vertices);
  require_rows("damping", damping.size(), vertices);
  SpringLoss result{Vector(vertices), Vector(vertices), Vector(vertices)};
#pragma omp parallel num_threads(worthwhile_threads(vertices, loss_cost* step_count(motions)))
  {
    VertexMotion motion;
#pragma omp for schedule(static)
    for (Eigen::Index v = 0; v < vertices; ++v) {
      motion.read(motions, v);
      const LossGradient sums = motion.loss_gradient(stiffness[v], damping[v]);
      result.loss[v] = sums.loss;
      result.by_stiffness[v] = sums.gradient[0];
      result.by_damping[v] = sums.gradient[1];
    }
  }
  return result;
}

}  // namespace followthrough
