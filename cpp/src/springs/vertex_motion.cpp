// SPDX-License-Identifier: GPL-3.0-or-later
// The recursion is that of Springs::step, in lags from the target and frames instead of seconds (springs_step.kernel.cpp):
//
//     lag'  = A lag + G rate + (3 I1 - 6 I2) bend - I1 turn
//     rate' = G' rate - R lag + (3 G - 6 I1) bend - G turn
//
// where the target's slopes at both ends of the frame give bend and turn.
#include "springs/vertex_motion.hpp"

#include "followthrough/springs/spring_derivatives.hpp"

namespace followthrough {
namespace {

/// What one frame does to lag and rate.
struct Step {
  explicit Step(const SpringCoefficients& k)
      : decay(k.decay),
        impulse(k.impulse),
        slope(k.impulse_slope),
        restoring(k.restoring),
        acceleration(k.acceleration),
        bend_lag(3.0 * k.acceleration - 6.0 * k.acceleration_slope),
        bend_rate(3.0 * k.impulse - 6.0 * k.acceleration) {}

  Axes lag(const Axes& l, const Axes& r, const Axes& bend, const Axes& turn) const {
    return (decay * l + impulse * r) + (bend_lag * bend - acceleration * turn);
  }
  Axes rate(const Axes& l, const Axes& r, const Axes& bend, const Axes& turn) const {
    return (slope * r - restoring * l) + (bend_rate * bend - impulse * turn);
  }

  double decay, impulse, slope, restoring, acceleration, bend_lag, bend_rate;
};

void add(LossGradient& sums, double weight, const Axes& error, const Axes& by_stiffness, const Axes& by_damping) {
  sums.loss += weight * (error * error).sum();
  sums.gradient[0] += 2.0 * weight * (error * by_stiffness).sum();
  sums.gradient[1] += 2.0 * weight * (error * by_damping).sum();
  sums.curvature(0, 0) += 2.0 * weight * (by_stiffness * by_stiffness).sum();
  sums.curvature(0, 1) += 2.0 * weight * (by_stiffness * by_damping).sum();
  sums.curvature(1, 1) += 2.0 * weight * (by_damping * by_damping).sum();
}

LossGradient none() { return {0.0, Eigen::Vector2d::Zero(), Eigen::Matrix2d::Zero()}; }

}  // namespace

void VertexMotion::read(std::span<const SpringTraining> motions, Eigen::Index vertex) {
  runs_.clear();
  bend_.clear();
  turn_.clear();
  wanted_.clear();
  excitation_ = lag_ = extent_ = size_ = 0.0;
  for (const SpringTraining& motion : motions) {
    const Eigen::Index last = motion.reference.rows() - 1;
    const auto at = [&](const ConstValues& values, Eigen::Index frame) -> Axes {
      const double* place = values.data() + frame * values.outerStride() + 3 * vertex;
      return {place[0], place[1], place[2], 0.0};
    };
    const std::size_t first_step = wanted_.size();
    const Axes start = at(motion.reference, 0);
    Axes here = start, next = at(motion.reference, 1);
    Axes slope = next - here;
    for (Eigen::Index frame = 0; frame < last; ++frame) {
      const Axes step = next - here;
      const Axes after = frame + 2 <= last ? at(motion.reference, frame + 2) : next;
      const Axes next_slope = frame + 2 <= last ? Axes(0.5 * (after - here)) : step;
      bend_.push_back((slope + next_slope) - (step + step));
      turn_.push_back(next_slope - slope);
      const Axes lag = at(motion.dynamic, frame + 1) - next;
      wanted_.push_back(lag);
      excitation_ += (bend_.back() * bend_.back() + turn_.back() * turn_.back()).sum();
      lag_ += (lag * lag).sum();
      extent_ += ((next - start) * (next - start)).sum();
      size_ += (next * next).sum();
      here = next;
      next = after;
      slope = next_slope;
    }
    runs_.push_back({first_step, wanted_.size(), motion.dt});
  }
  weights_.assign(wanted_.size(), 1.0);
}

void VertexMotion::scale_wanted(double factor) {
  for (Axes& wanted : wanted_) {
    wanted *= factor;
  }
}

double VertexMotion::weight_of_wanted() const {
  double sum = 0.0;
  for (std::size_t n = 0; n < wanted_.size(); ++n) {
    sum += weights_[n] * (wanted_[n] * wanted_[n]).sum();
  }
  return sum;
}

double VertexMotion::loss(double stiffness, double damping) const {
  double sum = 0.0;
  for (const Run& run : runs_) {
    const Step step(spring_coefficients(stiffness, damping, run.dt));
    Axes lag = Axes::Zero(), rate = Axes::Zero();
    for (std::size_t n = run.first; n < run.last; ++n) {
      const Axes before = lag;
      lag = step.lag(before, rate, bend_[n], turn_[n]);
      rate = step.rate(before, rate, bend_[n], turn_[n]);
      const Axes error = lag - wanted_[n];
      sum += weights_[n] * (error * error).sum();
    }
  }
  return sum;
}

void VertexMotion::squared_errors(double stiffness, double damping, std::vector<double>& errors) const {
  errors.resize(wanted_.size());
  for (const Run& run : runs_) {
    const Step step(spring_coefficients(stiffness, damping, run.dt));
    Axes lag = Axes::Zero(), rate = Axes::Zero();
    for (std::size_t n = run.first; n < run.last; ++n) {
      const Axes before = lag;
      lag = step.lag(before, rate, bend_[n], turn_[n]);
      rate = step.rate(before, rate, bend_[n], turn_[n]);
      const Axes error = lag - wanted_[n];
      errors[n] = (error * error).sum();
    }
  }
}

LossGradient VertexMotion::loss_gradient(double stiffness, double damping) const {
  LossGradient sums = none();
  for (const Run& run : runs_) {
    const SpringCoefficients factors = spring_coefficients(stiffness, damping, run.dt);
    const SpringDerivatives derivatives = spring_derivatives(stiffness, damping, run.dt, factors);
    const Step step(factors), by_stiffness(derivatives.stiffness), by_damping(derivatives.damping);
    const Axes zero = Axes::Zero();
    Axes lag = zero, rate = zero, stiff_lag = zero, stiff_rate = zero, damp_lag = zero, damp_rate = zero;
    for (std::size_t n = run.first; n < run.last; ++n) {
      const Axes &bend = bend_[n], &turn = turn_[n];
      // The chain rule: what the factors' change does, and what the lag's and rate's own has done until here.
      const Axes stiff_before = stiff_lag, damp_before = damp_lag, before = lag;
      stiff_lag = by_stiffness.lag(before, rate, bend, turn) + (step.decay * stiff_before + step.impulse * stiff_rate);
      damp_lag = by_damping.lag(before, rate, bend, turn) + (step.decay * damp_before + step.impulse * damp_rate);
      stiff_rate = by_stiffness.rate(before, rate, bend, turn) + (step.slope * stiff_rate - step.restoring * stiff_before);
      damp_rate = by_damping.rate(before, rate, bend, turn) + (step.slope * damp_rate - step.restoring * damp_before);
      lag = step.lag(before, rate, bend, turn);
      rate = step.rate(before, rate, bend, turn);
      add(sums, weights_[n], lag - wanted_[n], stiff_lag, damp_lag);
    }
  }
  sums.curvature(1, 0) = sums.curvature(0, 1);
  return sums;
}

LossGradient VertexMotion::one_frame_loss_gradient(double stiffness, double damping) const {
  // Two frames' lags give the third without the rate, which the recursion's two lines eliminate:
  // lag'' = (A + G') lag' - (A G' + G R) lag + forced' + G forced_rate - G' forced. Nothing is divided by.
  LossGradient sums = none();
  for (const Run& run : runs_) {
    const SpringCoefficients factors = spring_coefficients(stiffness, damping, run.dt);
    const SpringDerivatives derivatives = spring_derivatives(stiffness, damping, run.dt, factors);
    const Step step(factors);
    const Step by[2] = {Step(derivatives.stiffness), Step(derivatives.damping)};
    const double trace = step.decay + step.slope;
    const double shrinking = step.decay * step.slope + step.impulse * step.restoring;
    const Axes zero = Axes::Zero();
    for (std::size_t n = run.first + 1; n < run.last; ++n) {
      const double weight = weights_[n] * weights_[n - 1] * (n - 1 > run.first ? weights_[n - 2] : 1.0);
      const Axes before = n - 1 > run.first ? wanted_[n - 2] : zero;
      const Axes forced = step.lag(zero, zero, bend_[n - 1], turn_[n - 1]);
      const Axes forced_rate = step.rate(zero, zero, bend_[n - 1], turn_[n - 1]);
      const Axes next = (trace * wanted_[n - 1] - shrinking * before) +
                        (step.lag(zero, zero, bend_[n], turn_[n]) + step.impulse * forced_rate - step.slope * forced);
      Axes change[2];
      for (int k = 0; k < 2; ++k) {
        const Step& d = by[k];
        const double shrinking_change =
            d.decay * step.slope + step.decay * d.slope + d.impulse * step.restoring + step.impulse * d.restoring;
        change[k] = ((d.decay + d.slope) * wanted_[n - 1] - shrinking_change * before) +
                    (d.lag(zero, zero, bend_[n], turn_[n]) + d.impulse * forced_rate - d.slope * forced) +
                    (step.impulse * d.rate(zero, zero, bend_[n - 1], turn_[n - 1]) -
                     step.slope * d.lag(zero, zero, bend_[n - 1], turn_[n - 1]));
      }
      add(sums, weight, next - wanted_[n], change[0], change[1]);
    }
  }
  sums.curvature(1, 0) = sums.curvature(0, 1);
  return sums;
}

}  // namespace followthrough
