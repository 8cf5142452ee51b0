// SPDX-License-Identifier: GPL-3.0-or-later
// ImplicitEuler::step and its parts on a swinging block of soft flesh around a bone, at several sizes and qualities. Beside the
// time of a frame stand its Newton and conjugate gradient iterations, and how far its positions are from the converged ones after
// the whole motion, as a share of how far those are from the reference.
#include <benchmark/benchmark.h>

#include <cmath>

#include "elastic/block_matrix.hpp"
#include "elastic/conjugate_gradients.hpp"
#include "followthrough/elastic/implicit_euler.hpp"

namespace {

using namespace followthrough;

constexpr double edge = 0.2;
constexpr int frames = 12;

struct Scene {
  Positions rest;
  ElasticBody body;
  Mask constrained;
};

// A cube of `cells` cubes a side, its middle column constrained.
Scene scene(int cells, double youngs_modulus) {
  const int side = cells + 1;
  const auto vertex = [&](int x, int y, int z) { return static_cast<Index>((x * side + y) * side + z); };
  Positions rest(side * side * side, 3);
  Mask constrained(rest.rows());
  for (int x = 0; x < side; ++x) {
    for (int y = 0; y < side; ++y) {
      for (int z = 0; z < side; ++z) {
        rest.row(vertex(x, y, z)) << edge * x, edge * y, edge * z;
        constrained[vertex(x, y, z)] = std::abs(2 * x - cells) <= 2 && std::abs(2 * z - cells) <= 2;
      }
    }
  }
  const int cube[6][4] = {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}};  // bits: x y z
  Tets tets(6 * cells * cells * cells, 4);
  Eigen::Index tet = 0;
  for (int x = 0; x < cells; ++x) {
    for (int y = 0; y < cells; ++y) {
      for (int z = 0; z < cells; ++z) {
        for (const auto& corners : cube) {
          for (int k = 0; k < 4; ++k) {
            tets(tet, k) = vertex(x + (corners[k] >> 2), y + (corners[k] >> 1 & 1), z + (corners[k] & 1));
          }
          ++tet;
        }
      }
    }
  }
  ElasticBody body(rest, tets, {Vector::Constant(rest.rows(), youngs_modulus), Vector::Constant(rest.rows(), 1000.0)});
  return {std::move(rest), std::move(body), std::move(constrained)};
}

Positions reference(const Scene& s, int frame) {
  Positions moved = s.rest;
  moved.col(0).array() += 0.25 * std::sin(0.5 * frame);
  moved.col(2).array() += 0.15 * std::sin(0.9 * frame);
  return moved;
}

ImplicitEuler solver(const Scene& s, const NewtonSettings& newton) {
  return ImplicitEuler(s.body, std::make_shared<InvertibleStVK>(), s.constrained, std::sqrt(0.001), newton);
}

void implicit_euler_step(benchmark::State& state, const NewtonSettings& newton) {
  const Scene s = scene(static_cast<int>(state.range(0)), static_cast<double>(state.range(1)));
  ImplicitEuler exact = solver(s, NewtonSettings::converged()), tried = solver(s, newton);
  const SolverState start = [&] {
    exact.reset(reference(s, 0));
    return exact.state();
  }();
  for (int frame = 1; frame <= frames; ++frame) exact.step(reference(s, frame));
  double newton_iterations = 0, linear_iterations = 0;
  for (auto _ : state) {
    tried.restore(start);
    for (int frame = 1; frame <= frames; ++frame) {
      tried.step(reference(s, frame));
      newton_iterations += tried.last_step().iterations;
      linear_iterations += tried.last_step().linear_iterations;
    }
  }
  const double runs = static_cast<double>(state.iterations()) * frames;
  const Positions lag = exact.state().arrays[0] - reference(s, frames);
  state.counters["vertices"] = static_cast<double>(s.rest.rows());
  state.counters["newton"] = newton_iterations / runs;
  state.counters["cg"] = linear_iterations / runs;
  state.counters["error"] = (tried.state().arrays[0] - exact.state().arrays[0]).norm() / lag.norm();
  state.counters["s_a_frame"] = benchmark::Counter(runs, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

void elastic_forces(benchmark::State& state) {
  const Scene s = scene(static_cast<int>(state.range(0)), 5e4);
  const Positions bent = s.rest + 0.01 * Positions::Random(s.rest.rows(), 3);
  const InvertibleStVK stvk;
  for (auto _ : state) benchmark::DoNotOptimize(s.body.internal_forces(bent, stvk).data());
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * s.body.tet_count());
}

void elastic_stiffness(benchmark::State& state, Definiteness definiteness) {
  const Scene s = scene(static_cast<int>(state.range(0)), 5e4);
  const Positions bent = s.rest + 0.01 * Positions::Random(s.rest.rows(), 3);
  std::vector<Index> rows(static_cast<std::size_t>(s.rest.rows()));
  for (std::size_t v = 0; v < rows.size(); ++v) rows[v] = static_cast<Index>(v);
  BlockMatrix matrix(s.body.corners(), rows);
  const InvertibleStVK stvk;
  for (auto _ : state) {
    matrix.set_zero();
    s.body.add_stiffness(bent, stvk, definiteness, 1.0, matrix);
    benchmark::DoNotOptimize(matrix.blocks().data());
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * s.body.tet_count());
}

void sizes(benchmark::internal::Benchmark* bench) {
  bench->ArgsProduct({{10, 20}, {50000, 5000000}})->ArgNames({"cells", "modulus"})->Unit(benchmark::kMillisecond)->UseRealTime();
}

BENCHMARK(elastic_forces)->Arg(10)->Arg(32)->Unit(benchmark::kMicrosecond)->UseRealTime();
BENCHMARK_CAPTURE(elastic_stiffness, exact, Definiteness::kSymmetric)
    ->Arg(10)
    ->Arg(32)
    ->Unit(benchmark::kMicrosecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(elastic_stiffness, semidefinite, Definiteness::kSemidefinite)
    ->Arg(10)
    ->Unit(benchmark::kMicrosecond)
    ->UseRealTime();
BENCHMARK_CAPTURE(implicit_euler_step, preview, NewtonSettings::preview())->Apply(sizes);
BENCHMARK_CAPTURE(implicit_euler_step, fine, NewtonSettings::fine())->Apply(sizes);
BENCHMARK_CAPTURE(implicit_euler_step, converged, NewtonSettings::converged())
    ->ArgsProduct({{10}, {50000, 5000000}})
    ->ArgNames({"cells", "modulus"})
    ->Unit(benchmark::kMillisecond)
    ->UseRealTime();

}  // namespace
