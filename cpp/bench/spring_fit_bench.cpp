// SPDX-License-Identifier: GPL-3.0-or-later
// Learning the constants of 14,000 vertices on 100 frames of waves, with noise of a tenth of the motion. spring_fit_time.py beside
// it fits a few of such vertices with a straight Python implementation, for the ratio.
#include <benchmark/benchmark.h>
#include <omp.h>

#include <cmath>
#include <random>

#include "followthrough/springs/spring_fit.hpp"
#include "springs/vertex_motion.hpp"

namespace {

using namespace followthrough;

constexpr double dt = 1.0 / 24.0;

struct Motion {
  Values reference, dynamic;
};

Motion motion(Eigen::Index frames, Eigen::Index vertices) {
  std::mt19937 random(1);
  std::normal_distribution<double> number;
  std::uniform_real_distribution<double> share;
  Motion made{Values::Zero(frames, 3 * vertices), Values(frames, 3 * vertices)};
  for (Eigen::Index column = 0; column < 3 * vertices; ++column) {
    for (int wave = 0; wave < 4; ++wave) {
      const double size = 0.1 * number(random), rate = 1.0 + 12.0 * share(random), phase = 6.0 * share(random);
      for (Eigen::Index frame = 0; frame < frames; ++frame) {
        made.reference(frame, column) += size * std::sin(rate * dt * static_cast<double>(frame) + phase);
      }
    }
  }
  made.dynamic = made.reference;
  for (Eigen::Index v = 0; v < vertices; ++v) {
    const double stiffness = std::pow(10.0, 1.0 + 3.0 * share(random)), ratio = std::pow(10.0, -1.7 + 3.0 * share(random));
    const SpringCoefficients k = spring_coefficients(stiffness, 2.0 * ratio * std::sqrt(stiffness), dt);
    for (Eigen::Index column = 3 * v; column < 3 * v + 3; ++column) {
      // A target that jumps from frame to frame is enough here: the motion need not be the springs' own to be fitted.
      double lag = 0.0, rate = 0.0;
      for (Eigen::Index frame = 1; frame < frames; ++frame) {
        const double push = made.reference(frame, column) - made.reference(frame - 1, column);
        const double next = k.decay * (lag - push) + k.impulse * rate;
        rate = k.impulse_slope * rate - k.restoring * (lag - push);
        lag = next;
        made.dynamic(frame, column) += lag + 0.01 * number(random);
      }
    }
  }
  return made;
}

void spring_fit(benchmark::State& state) {
  const Motion made = motion(100, state.range(0));
  const SpringTraining training[] = {{made.reference, made.dynamic, dt}};
  const int usual = omp_get_max_threads();
  omp_set_num_threads(static_cast<int>(state.range(1)));
  SpringFitSettings settings;
  settings.dropped_share = state.range(2) != 0 ? 0.1 : 0.0;
  for (auto _ : state) {
    const SpringFit fit = fit_springs(training, Mask(), 0, state.range(0), settings);
    benchmark::DoNotOptimize(fit.stiffness.data());
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * state.range(0));
  omp_set_num_threads(usual);
}

// One evaluation of one vertex's loss, alone and with its derivatives.
void spring_loss(benchmark::State& state) {
  const Motion made = motion(100, 1);
  const SpringTraining training[] = {{made.reference, made.dynamic, dt}};
  VertexMotion vertex;
  vertex.read(training, 0);
  double stiffness = 100.0;
  for (auto _ : state) {
    stiffness *= 1.0000001;
    if (state.range(0) == 0) {
      benchmark::DoNotOptimize(vertex.loss(stiffness, 8.0));
    } else {
      benchmark::DoNotOptimize(vertex.loss_gradient(stiffness, 8.0));
    }
  }
}

BENCHMARK(spring_fit)
    ->ArgsProduct({{14000}, {1, 2}, {0, 1}})
    ->ArgNames({"vertices", "threads", "robust"})
    ->Unit(benchmark::kMillisecond)
    ->Iterations(1)
    ->UseRealTime();
BENCHMARK(spring_loss)->Arg(0)->Arg(1)->ArgName("gradient");

}  // namespace
