// SPDX-License-Identifier: GPL-3.0-or-later
// Positions are three numbers a vertex and factors one, which compilers do not vectorise by themselves: factors of as many vertices
// as a register has lanes are loaded once and spread over the three registers of those vertices' positions. Every number goes
// through the same operations in the same order whatever the width, so all instruction sets give the same bits.
#include "springs/springs_step.hpp"

#if defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
#define FOLLOWTHROUGH_VECTORS
#endif
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// One number of a position, or a register of them; Number is double or a vector of doubles.
template <typename Number>
struct Moved {
  Number position, velocity;
};

template <typename Number>
inline Moved<Number> moved(const SpringsStep& frame, double rate, Number position, Number velocity, Number before, Number start,
                           Number end, Number after, Number decay, Number impulse, Number impulse_slope, Number restoring,
                           Number acceleration, Number bend_position, Number bend_velocity) {
  const Number step = end - start;
  const Number slope0 = frame.start_slope * (end - before);
  const Number slope1 = frame.end_slope * (after - start);
  // The cubic's acceleration over the frame is turn - 3 bend + 6 bend * s ([ZS] eqs. 2 to 4), in units a frame squared.
  const Number bend = (slope0 + slope1) - (step + step);
  const Number turn = slope1 - slope0;
  const Number lag = position - start;
  const Number lag_rate = velocity * frame.duration - slope0;
  return {end + ((decay * lag + impulse * lag_rate) + (bend_position * bend - acceleration * turn)),
          rate * (slope1 + ((impulse_slope * lag_rate - restoring * lag) + (bend_velocity * bend - impulse * turn)))};
}

// The factor of the bend in the velocity.
template <typename Number>
inline Number bend_of_velocity(Number impulse, Number acceleration) {
  return 3.0 * impulse - 6.0 * acceleration;
}

// The first of a vertex's factors.
inline const double* factors_of(const SpringsStep& frame, std::int64_t v) {
  return frame.factors + v / factor_group * (factor_count * factor_group) + v % factor_group;
}

#ifdef FOLLOWTHROUGH_VECTORS
#if defined(__AVX512F__)
constexpr int lanes = 8;
#define FOLLOWTHROUGH_SPREAD0(f) __builtin_shufflevector(f, f, 0, 0, 0, 1, 1, 1, 2, 2)
#define FOLLOWTHROUGH_SPREAD1(f) __builtin_shufflevector(f, f, 2, 3, 3, 3, 4, 4, 4, 5)
#define FOLLOWTHROUGH_SPREAD2(f) __builtin_shufflevector(f, f, 5, 5, 6, 6, 6, 7, 7, 7)
#elif defined(__AVX__)
constexpr int lanes = 4;
#define FOLLOWTHROUGH_SPREAD0(f) __builtin_shufflevector(f, f, 0, 0, 0, 1)
#define FOLLOWTHROUGH_SPREAD1(f) __builtin_shufflevector(f, f, 1, 1, 2, 2)
#define FOLLOWTHROUGH_SPREAD2(f) __builtin_shufflevector(f, f, 2, 3, 3, 3)
#else
constexpr int lanes = 2;
#define FOLLOWTHROUGH_SPREAD0(f) __builtin_shufflevector(f, f, 0, 0)
#define FOLLOWTHROUGH_SPREAD1(f) __builtin_shufflevector(f, f, 0, 1)
#define FOLLOWTHROUGH_SPREAD2(f) __builtin_shufflevector(f, f, 1, 1)
#endif
using Lanes = double __attribute__((vector_size(8 * lanes)));
using LanesInMemory = double __attribute__((vector_size(8 * lanes), aligned(8), may_alias));

inline Lanes load(const double* place) { return *reinterpret_cast<const LanesInMemory*>(place); }
inline void store(double* place, Lanes values) { *reinterpret_cast<LanesInMemory*>(place) = values; }

inline void move_lanes(const SpringsStep& frame, double rate, std::int64_t i, Lanes decay, Lanes impulse, Lanes impulse_slope,
                       Lanes restoring, Lanes acceleration, Lanes bend_position, Lanes bend_velocity) {
  const Lanes end = load(frame.end + i);
  const Moved<Lanes> now = moved<Lanes>(frame, rate, load(frame.positions + i), load(frame.velocities + i), load(frame.before + i),
                                        load(frame.start + i), end, load(frame.after + i), decay, impulse, impulse_slope, restoring,
                                        acceleration, bend_position, bend_velocity);
  store(frame.before + i, end);
  store(frame.positions + i, now.position);
  store(frame.velocities + i, now.velocity);
}
#endif

}  // namespace

void springs_step(const SpringsStep& arrays, std::int64_t first, std::int64_t last) noexcept {
  const SpringsStep frame = arrays;  // nobody else writes this copy, so its pointers stay in registers
  const double rate = 1.0 / frame.duration;
  std::int64_t v = first;
#ifdef FOLLOWTHROUGH_VECTORS
  for (; v + lanes <= last; v += lanes) {
    const double* factors = factors_of(frame, v);
    const Lanes decay = load(factors + factor_group * decay_factor);
    const Lanes impulse = load(factors + factor_group * impulse_factor);
    const Lanes impulse_slope = load(factors + factor_group * impulse_slope_factor);
    const Lanes restoring = load(factors + factor_group * restoring_factor);
    const Lanes acceleration = load(factors + factor_group * acceleration_factor);
    const Lanes bend_position = load(factors + factor_group * bend_factor);
    const Lanes bend_velocity = bend_of_velocity(impulse, acceleration);
    move_lanes(frame, rate, 3 * v, FOLLOWTHROUGH_SPREAD0(decay), FOLLOWTHROUGH_SPREAD0(impulse),
               FOLLOWTHROUGH_SPREAD0(impulse_slope), FOLLOWTHROUGH_SPREAD0(restoring), FOLLOWTHROUGH_SPREAD0(acceleration),
               FOLLOWTHROUGH_SPREAD0(bend_position), FOLLOWTHROUGH_SPREAD0(bend_velocity));
    move_lanes(frame, rate, 3 * v + lanes, FOLLOWTHROUGH_SPREAD1(decay), FOLLOWTHROUGH_SPREAD1(impulse),
               FOLLOWTHROUGH_SPREAD1(impulse_slope), FOLLOWTHROUGH_SPREAD1(restoring), FOLLOWTHROUGH_SPREAD1(acceleration),
               FOLLOWTHROUGH_SPREAD1(bend_position), FOLLOWTHROUGH_SPREAD1(bend_velocity));
    move_lanes(frame, rate, 3 * v + 2 * lanes, FOLLOWTHROUGH_SPREAD2(decay), FOLLOWTHROUGH_SPREAD2(impulse),
               FOLLOWTHROUGH_SPREAD2(impulse_slope), FOLLOWTHROUGH_SPREAD2(restoring), FOLLOWTHROUGH_SPREAD2(acceleration),
               FOLLOWTHROUGH_SPREAD2(bend_position), FOLLOWTHROUGH_SPREAD2(bend_velocity));
  }
#endif
  for (; v < last; ++v) {
    const double* factors = factors_of(frame, v);
    const double impulse = factors[factor_group * impulse_factor], acceleration = factors[factor_group * acceleration_factor];
    const double bend_velocity = bend_of_velocity(impulse, acceleration);
    for (std::int64_t i = 3 * v; i < 3 * v + 3; ++i) {
      const double end = frame.end[i];
      const Moved<double> now =
          moved<double>(frame, rate, frame.positions[i], frame.velocities[i], frame.before[i], frame.start[i], end, frame.after[i],
                        factors[factor_group * decay_factor], impulse, factors[factor_group * impulse_slope_factor],
                        factors[factor_group * restoring_factor], acceleration, factors[factor_group * bend_factor], bend_velocity);
      frame.before[i] = end;
      frame.positions[i] = now.position;
      frame.velocities[i] = now.velocity;
    }
  }
}

bool finite_sum(const double* values, std::int64_t count) noexcept {
  // No addition removes an infinity or NaN from a sum.
  double sum = 0.0;
  std::int64_t i = 0;
#ifdef FOLLOWTHROUGH_VECTORS
  Lanes sums[4] = {};
  for (; i + 4 * lanes <= count; i += 4 * lanes) {
    for (int k = 0; k < 4; ++k) sums[k] += load(values + i + lanes * k);
  }
  const Lanes all = (sums[0] + sums[1]) + (sums[2] + sums[3]);
  for (int k = 0; k < lanes; ++k) sum += all[k];
#endif
  for (; i < count; ++i) sum += values[i];
  return sum - sum == 0.0;
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
