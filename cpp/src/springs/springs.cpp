// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/springs/springs.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "followthrough/errors.hpp"
#include "followthrough/springs/particle.hpp"
#include "followthrough/springs/spring_coefficients.hpp"
#include "instruction_set.hpp"
#include "springs/springs_step.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

// Vertices a thread takes at a time; whole groups of factors.
constexpr Eigen::Index block = 2048;
static_assert(block % factor_group == 0);
// Nanoseconds a vertex, for worthwhile_threads.
constexpr double coefficients_cost = 150;
constexpr double step_cost = 8;
constexpr double finite_cost = 2;
constexpr double evaluate_cost = 200;

struct Kernels {
  decltype(&baseline::springs_step) step;
  decltype(&baseline::finite_sum) finite_sum;
};

Kernels kernels() { return {FOLLOWTHROUGH_KERNEL(springs_step), FOLLOWTHROUGH_KERNEL(finite_sum)}; }

template <typename Work>
void for_blocks(Eigen::Index count, double nanoseconds, const Work& work) {
  const Eigen::Index blocks = (count + block - 1) / block;
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(count, nanoseconds))
  for (Eigen::Index b = 0; b < blocks; ++b) {
    work(b * block, std::min((b + 1) * block, count));
  }
}

// Both references in one pass over the threads; null: none. Slow only where there is something to complain about.
void require_finite_references(const double* reference, const double* next_reference, Eigen::Index vertices) {
  const auto finite_sum = kernels().finite_sum;
  const Eigen::Index blocks = (vertices + block - 1) / block;
  bool finite = true;
#pragma omp parallel for schedule(static) reduction(&& : finite) num_threads(worthwhile_threads(vertices, finite_cost))
  for (Eigen::Index b = 0; b < blocks; ++b) {
    const Eigen::Index first = 3 * b * block;
    const Eigen::Index count = std::min(3 * block, 3 * vertices - first);
    finite = finite && finite_sum(reference + first, count) && (!next_reference || finite_sum(next_reference + first, count));
  }
  if (!finite) {
    require_finite("reference", Eigen::Map<const Positions>(reference, vertices, 3));
    if (next_reference) require_finite("next_reference", Eigen::Map<const Positions>(next_reference, vertices, 3));
  }
}

void require_constants(const char* name, ConstVector values) {
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    if (!(std::isfinite(values[i]) && values[i] >= 0.0)) {
      throw InvalidInput(
          name, "found " + std::to_string(values[i]) + " at vertex " + std::to_string(i) + ", expected finite numbers, 0 or more");
    }
  }
}

// The kernels want rows without gaps, and arrays that are not the ones they write.
class DenseRows {
 public:
  DenseRows(ConstPositions positions, const double* written) : data_(positions.data()) {
    if ((positions.rows() > 1 && positions.outerStride() != 3) || data_ == written) {
      copy_ = positions;
      data_ = copy_.data();
    }
  }
  DenseRows(const DenseRows&) = delete;
  DenseRows& operator=(const DenseRows&) = delete;
  const double* data() const { return data_; }

 private:
  Positions copy_;
  const double* data_;
};

// Vertices often share their constants: all of a character that is not painted, all stiff ones of a fit. Those met last are kept.
class RecentCoefficients {
 public:
  explicit RecentCoefficients(double dt) : dt_(dt) {}
  const SpringCoefficients& of(double stiffness, double damping) {
    for (const Entry& entry : entries_) {
      if (entry.known && entry.stiffness == stiffness && entry.damping == damping) {
        return entry.coefficients;
      }
    }
    Entry& entry = entries_[oldest_];
    oldest_ = (oldest_ + 1) % entries_.size();
    entry = {true, stiffness, damping, spring_coefficients(stiffness, damping, dt_)};
    return entry.coefficients;
  }

 private:
  struct Entry {
    bool known;
    double stiffness, damping;
    SpringCoefficients coefficients;
  };
  double dt_;
  std::array<Entry, 4> entries_{};
  std::size_t oldest_ = 0;
};

}  // namespace

Springs::Springs(ConstVector stiffness, ConstVector damping, double dt, ConstMask pinned, const Eigen::Vector3d& gravity)
    : stiffness_(stiffness), damping_(damping), dt_(dt) {
  if (!(std::isfinite(dt) && dt > 0.0)) {
    throw InvalidInput("dt", "found " + std::to_string(dt) + ", expected a positive number of seconds");
  }
  const Eigen::Index count = stiffness_.size();
  require_rows("damping", damping_.size(), count);
  require_constants("stiffness", stiffness_);
  require_constants("damping", damping_);
  if (pinned.size() != 0) {
    require_rows("pinned", pinned.size(), count);
    for (Eigen::Index v = 0; v < count; ++v) {
      if (pinned[v]) {
        pinned_.push_back(static_cast<Index>(v));
      }
    }
  }
  require_finite("gravity", gravity.transpose());
  if (!gravity.isZero(0.0)) {
    sag_.setZero(count, 3);
    auto pin = pinned_.begin();
    for (Eigen::Index v = 0; v < count; ++v) {
      if (pin != pinned_.end() && *pin == v) {
        ++pin;
        continue;
      }
      if (stiffness_[v] == 0.0) {
        throw InvalidInput("gravity", "found some, and a stiffness of 0 at vertex " + std::to_string(v) +
                                          ", expected springs that hold every vertex (it would fall for ever)");
      }
      sag_.row(v) = gravity.transpose() / stiffness_[v];
    }
    require_finite("gravity", sag_);
  }
  factors_.setZero((count + factor_group - 1) / factor_group * factor_count, factor_group);
  for_blocks(count, coefficients_cost, [&](Eigen::Index first, Eigen::Index last) {
    auto pin = std::lower_bound(pinned_.begin(), pinned_.end(), first);
    RecentCoefficients coefficients(dt_);
    for (Eigen::Index v = first; v < last; ++v) {
      if (pin != pinned_.end() && *pin == v) {
        ++pin;
        continue;  // all zero
      }
      const SpringCoefficients& k = coefficients.of(stiffness_[v], damping_[v]);
      factors_.block<factor_count, 1>(v / factor_group * factor_count, v % factor_group) << k.decay, k.impulse, k.impulse_slope,
          k.restoring, k.acceleration, 3.0 * k.acceleration - 6.0 * k.acceleration_slope;
    }
  });
}

void Springs::require_references(ConstPositions reference, const Positions* next_reference) const {
  if (frames_ < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), vertex_count());
  if (next_reference) {
    require_rows("next_reference", next_reference->rows(), vertex_count());
  }
}

void Springs::reset(ConstPositions reference) {
  require_rows("reference", reference.rows(), vertex_count());
  {
    const DenseRows rows(reference, nullptr);
    require_finite_references(rows.data(), nullptr, vertex_count());
  }
  reference_ = reference;
  before_ = reference_;
  positions_ = reference_;
  velocities_.setZero(vertex_count(), 3);
  frames_ = 0;
}

const Positions& Springs::step(ConstPositions reference, const Positions* next_reference) {
  require_references(reference, next_reference);
  const DenseRows end(reference, positions_.data());
  const DenseRows after(next_reference ? ConstPositions(*next_reference) : reference, positions_.data());
  require_finite_references(end.data(), next_reference ? after.data() : nullptr, vertex_count());
  const Eigen::Index count = vertex_count();
  SpringsStep frame{};
  frame.positions = positions_.data();
  frame.velocities = velocities_.data();
  frame.before = before_.data();
  frame.start = reference_.data();
  frame.end = end.data();
  frame.after = after.data();
  frame.start_slope = frames_ == 0 ? 1.0 : 0.5;
  frame.end_slope = next_reference ? 0.5 : 1.0;
  frame.duration = dt_;
  frame.factors = factors_.data();
  const auto springs_step = kernels().step;
  const bool first_frame = frames_ == 0;
  for_blocks(count, step_cost, [&](Eigen::Index first, Eigen::Index last) {
    if (first_frame) {
      for (Eigen::Index i = 3 * first; i < 3 * last; ++i) {
        frame.velocities[i] = (frame.end[i] - frame.start[i]) / dt_;
      }
    }
    const bool sags = sag_.rows() > 0;
    if (sags) positions_.middleRows(first, last - first) -= sag_.middleRows(first, last - first);
    springs_step(frame, first, last);
    if (sags) positions_.middleRows(first, last - first) += sag_.middleRows(first, last - first);
    const auto pin = std::lower_bound(pinned_.begin(), pinned_.end(), first);
    for (auto p = pin; p != pinned_.end() && *p < last; ++p) {
      for (Eigen::Index i = 3 * Eigen::Index{*p}; i < 3 * Eigen::Index{*p} + 3; ++i) {
        frame.positions[i] = frame.end[i];  // bit for bit: the kernel's sum would turn -0 into 0
      }
    }
  });
  reference_.swap(before_);
  ++frames_;
  return positions_;
}

Positions Springs::evaluate(double fraction, ConstPositions reference, const Positions* next_reference) const {
  require_references(reference, next_reference);
  if (!(fraction >= 0.0 && fraction <= 1.0)) {
    throw InvalidInput("fraction", "found " + std::to_string(fraction) + ", expected 0 to 1");
  }
  require_finite("reference", reference);
  if (next_reference) {
    require_finite("next_reference", *next_reference);
  }
  Positions result(vertex_count(), 3);
  for_blocks(vertex_count(), evaluate_cost, [&](Eigen::Index first, Eigen::Index last) {
    auto pin = std::lower_bound(pinned_.begin(), pinned_.end(), first);
    for (Eigen::Index v = first; v < last; ++v) {
      const Eigen::Vector3d start = reference_.row(v), end = reference.row(v);
      const Eigen::Vector3d one_sided = (end - start) / dt_;
      Eigen::Vector3d start_velocity = one_sided, end_velocity = one_sided;
      if (frames_ > 0) {
        start_velocity = (end - before_.row(v).transpose()) / (2.0 * dt_);
      }
      if (next_reference) {
        end_velocity = (next_reference->row(v).transpose() - start) / (2.0 * dt_);
      }
      const CubicTarget target = CubicTarget::hermite(start, end, start_velocity, end_velocity, dt_);
      if (pin != pinned_.end() && *pin == v) {
        result.row(v) = target.position(fraction * dt_).transpose();
        ++pin;
        continue;
      }
      const Eigen::Vector3d velocity = frames_ == 0 ? start_velocity : Eigen::Vector3d(velocities_.row(v).transpose());
      const Eigen::Vector3d sag = sag_.rows() > 0 ? Eigen::Vector3d(sag_.row(v)) : Eigen::Vector3d::Zero();
      const Particle particle{positions_.row(v).transpose() - sag, velocity};
      result.row(v) = (advance(particle, target, 0.0, fraction * dt_, stiffness_[v], damping_[v]).position + sag).transpose();
    }
  });
  return result;
}

SolverState Springs::state() const { return {{positions_, velocities_, reference_, before_}, {frames_}}; }

void Springs::restore(const SolverState& state) {
  if (state.arrays.size() != 4 || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) +
                                    " counters, expected 4 and 1 as Springs.state gives them");
  }
  const Eigen::Index rows = state.counters[0] < 0 ? 0 : vertex_count();
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), rows);
    require_finite("state", array);
  }
  positions_ = state.arrays[0];
  velocities_ = state.arrays[1];
  reference_ = state.arrays[2];
  before_ = state.arrays[3];
  frames_ = state.counters[0];
}

}  // namespace followthrough
