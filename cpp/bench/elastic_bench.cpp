// SPDX-License-Identifier: GPL-3.0-or-later
// ImplicitEuler on a dance (dancer.hpp): against Newton's method with Eigen's linear solvers at the same residual, frame by frame
// in turns; what each quality costs over the whole dance and how far it is from converged; and the parts of a step.
#include <benchmark/benchmark.h>
#include <sys/resource.h>

#include <cmath>
#include <ctime>

#include "dancer.hpp"
#include "elastic/block_matrix.hpp"
#include "elastic/sparse_cholesky.hpp"
#include "followthrough/elastic/backward_euler_force.hpp"
#include "followthrough/elastic/implicit_euler.hpp"
#include "plain_newton.hpp"

namespace {

using namespace followthrough;

struct Scene {
  Dancer dancer;
  ElasticBody body;
};

Scene scene(double edge, double youngs_modulus) {
  Dancer dancer(edge);
  const Eigen::Index count = dancer.rest.rows();
  ElasticBody body(dancer.rest, dancer.tets, {Vector::Constant(count, youngs_modulus), Vector::Constant(count, 1000.0)});
  return {std::move(dancer), std::move(body)};
}

Scene scene(const benchmark::State& state) {
  return scene(1e-3 * static_cast<double>(state.range(0)), static_cast<double>(state.range(1)));
}

ImplicitEuler solver(const Scene& s, const NewtonSettings& newton) {
  return ImplicitEuler(s.body, std::make_shared<InvertibleStVK>(), s.dancer.constrained, Dancer::dt, newton);
}

// The processor's time, of all threads: other work on the machine does not count.
double seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

// Root mean square distance a vertex, m.
double distance(const Positions& a, const Positions& b) { return (a - b).norm() / std::sqrt(static_cast<double>(a.rows())); }

// Seconds of a step by ImplicitEuler and by two plain Newton methods, all from the same state and to the same residual.
void against_plain_eigen(benchmark::State& state) {
  const Scene s = scene(state);
  const double tolerance = state.range(2) == 0 ? 1e-2 : 1e-8;
  const auto frames = static_cast<int>(state.range(3));
  ImplicitEuler history = solver(s, NewtonSettings::fine()), ours = solver(s, {tolerance, 100, 2000});
  PlainNewton<PlainCholesky> cholesky(s.body, s.dancer.constrained, Dancer::dt);
  PlainNewton<PlainConjugateGradients> gradients(s.body, s.dancer.constrained, Dancer::dt);
  double own = 0, direct = 0, iterative = 0, apart = 0;
  for (auto _ : state) {
    history.reset(s.dancer.reference(0));
    for (int frame = 1; frame <= frames; ++frame) {
      const SolverState before = history.state();
      const Positions reference = s.dancer.reference(frame);
      ours.restore(before);
      double start = seconds();
      const Positions x = ours.step(reference);
      own += seconds() - start;
      if (frame % 4 == 0) {  // they take their time
        start = seconds();
        const Positions y = cholesky.step(before.arrays[0], before.arrays[1], before.arrays[2], reference, tolerance);
        direct += 4 * (seconds() - start);
        start = seconds();
        const Positions z = gradients.step(before.arrays[0], before.arrays[1], before.arrays[2], reference, tolerance);
        iterative += 4 * (seconds() - start);
        apart = std::max({apart, distance(x, y), distance(x, z)});
      }
      history.step(reference);
    }
    state.SetIterationTime(own);
  }
  const double steps = static_cast<double>(state.iterations()) * frames;
  state.counters["vertices"] = static_cast<double>(s.dancer.rest.rows());
  state.counters["ours_ms"] = 1e3 * own / steps;
  state.counters["ldlt_ms"] = 1e3 * direct / steps;
  state.counters["jacobi_cg_ms"] = 1e3 * iterative / steps;
  state.counters["ldlt_over_ours"] = direct / own;
  state.counters["jacobi_cg_over_ours"] = iterative / own;
  state.counters["apart_m"] = apart;
}

// A whole dance in one quality; errors against the converged dance.
void dance(benchmark::State& state, const NewtonSettings& newton) {
  const Scene s = scene(state);
  const auto frames = static_cast<int>(state.range(2));
  ImplicitEuler exact = solver(s, NewtonSettings::converged()), tried = solver(s, newton);
  double slowest = 0, total = 0, error = 0, lag = 0, worst = 0, one_frame = 0, newton_iterations = 0, missed = 0;
  for (auto _ : state) {
    exact.reset(s.dancer.reference(0));
    tried.reset(s.dancer.reference(0));
    for (int frame = 1; frame <= frames; ++frame) {
      const Positions reference = s.dancer.reference(frame);
      const double start = seconds();
      const Positions x = tried.step(reference);
      const double taken = seconds() - start;
      newton_iterations += tried.last_step().iterations;
      const SolverState after = tried.state(), before = exact.state();
      missed += tried.last_step().converged ? 0 : 1;
      const Positions truth = exact.step(reference);
      tried.restore(before);
      one_frame += std::pow(distance(tried.step(reference), truth), 2);
      tried.restore(after);
      total += taken;
      slowest = std::max(slowest, taken);
      error += std::pow(distance(x, truth), 2);
      worst = std::max(worst, distance(x, truth));
      lag += std::pow(distance(truth, reference), 2);
    }
    state.SetIterationTime(total);
  }
  const double steps = static_cast<double>(state.iterations()) * frames;
  state.counters["vertices"] = static_cast<double>(s.dancer.rest.rows());
  state.counters["ms"] = 1e3 * total / steps;
  state.counters["slowest_ms"] = 1e3 * slowest;
  state.counters["newton"] = newton_iterations / steps;
  state.counters["above_tolerance"] = missed / static_cast<double>(state.iterations());
  state.counters["one_frame_m"] = std::sqrt(one_frame / steps);
  state.counters["error_m"] = std::sqrt(error / steps);
  state.counters["worst_m"] = worst;
  state.counters["lag_m"] = std::sqrt(lag / steps);
}

// Time alone, and the process's largest memory.
void large_dance(benchmark::State& state, const NewtonSettings& newton) {
  const Scene s = scene(state);
  ImplicitEuler tried = solver(s, newton);
  tried.reset(s.dancer.reference(0));
  int frame = 0;
  double newton_iterations = 0, missed = 0;
  for (auto _ : state) {
    tried.step(s.dancer.reference(++frame));
    newton_iterations += tried.last_step().iterations;
    missed += tried.last_step().converged ? 0 : 1;
  }
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  state.counters["vertices"] = static_cast<double>(s.dancer.rest.rows());
  state.counters["newton"] = newton_iterations / frame;
  state.counters["above_tolerance"] = missed;
  state.counters["memory_MB"] = static_cast<double>(usage.ru_maxrss) / 1024;
}

void elastic_forces(benchmark::State& state) {
  const Scene s = scene(state);
  const Positions bent = s.dancer.rest + 0.01 * Positions::Random(s.dancer.rest.rows(), 3);
  const InvertibleStVK stvk;
  for (auto _ : state) benchmark::DoNotOptimize(s.body.internal_forces(bent, stvk).data());
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * s.body.tet_count());
}

// Microseconds a vertex of the processor's time, mass included.
void backward_euler_force(benchmark::State& state, BackwardEulerForce::Precision precision) {
  const Scene s = scene(state);
  const Positions bent = s.dancer.rest + 0.01 * Positions::Random(s.dancer.rest.rows(), 3);
  BackwardEulerForce force(s.body, Dancer::dt, precision);
  Positions result(bent.rows(), 3);
  for (auto _ : state) {
    force.evaluate(bent, s.dancer.rest, result);
    benchmark::DoNotOptimize(result.data());
  }
  state.counters["s_per_vertex"] = benchmark::Counter(static_cast<double>(state.iterations()) * static_cast<double>(bent.rows()),
                                                      benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
}

struct Assembled {
  Scene scene;
  Positions bent;
  BlockMatrix matrix;
};

Assembled assembled(const benchmark::State& state) {
  Scene s = scene(state);
  std::vector<Index> rows(static_cast<std::size_t>(s.dancer.rest.rows()));
  for (std::size_t v = 0; v < rows.size(); ++v) rows[v] = static_cast<Index>(v);
  BlockMatrix matrix(s.body.corners(), rows);
  s.body.add_mass(1.0, matrix);
  const Positions bent = s.dancer.rest + 0.01 * Positions::Random(s.dancer.rest.rows(), 3);
  s.body.add_stiffness(bent, InvertibleStVK(), Definiteness::kConvex, Dancer::dt * Dancer::dt, matrix);
  return {std::move(s), bent, std::move(matrix)};
}

void elastic_stiffness(benchmark::State& state, Definiteness definiteness) {
  Assembled a = assembled(state);
  for (auto _ : state) {
    a.matrix.set_zero();
    a.scene.body.add_stiffness(a.bent, InvertibleStVK(), definiteness, 1.0, a.matrix);
    benchmark::DoNotOptimize(a.matrix.blocks().data());
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * a.scene.body.tet_count());
}

void factorization(benchmark::State& state) {
  const Assembled a = assembled(state);
  SparseCholesky factor(a.matrix);
  for (auto _ : state) benchmark::DoNotOptimize(factor.compute(a.matrix));
  state.counters["numbers"] = static_cast<double>(factor.size());
  state.counters["flops"] =
      benchmark::Counter(2 * factor.work() * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

void factor_solve(benchmark::State& state) {
  const Assembled a = assembled(state);
  SparseCholesky factor(a.matrix);
  factor.compute(a.matrix);
  const Vector b = Vector::Random(3 * a.matrix.row_count());
  Vector z(b.size());
  for (auto _ : state) {
    factor.apply(b, z);
    benchmark::DoNotOptimize(z.data());
  }
}

// Arguments: edge in mm (185: 1,500 vertices, 100: 7,700, 72: 20,000, 55: 41,000), Young's modulus, ...
BENCHMARK(against_plain_eigen)
    ->ArgNames({"edge", "modulus", "tight", "frames"})
    ->ArgsProduct({{185}, {50000, 5000000}, {0, 1}, {48}})
    ->ArgsProduct({{100}, {50000, 5000000}, {0}, {8}})
    ->ArgsProduct({{72}, {50000, 5000000}, {0}, {4}})
    ->UseManualTime()
    ->Iterations(1)
    ->Unit(benchmark::kMillisecond);
void dances(benchmark::internal::Benchmark* bench) {
  bench->ArgNames({"edge", "modulus", "frames"})
      ->ArgsProduct({{185}, {50000, 5000000}, {Dancer::frames}})
      ->UseManualTime()
      ->Iterations(1)
      ->Unit(benchmark::kMillisecond);
}
BENCHMARK_CAPTURE(dance, preview, NewtonSettings::preview())->Apply(dances);
BENCHMARK_CAPTURE(dance, fine, NewtonSettings::fine())->Apply(dances);
BENCHMARK_CAPTURE(dance, converged, NewtonSettings::converged())->Apply(dances);
void large(benchmark::internal::Benchmark* bench) {
  bench->ArgNames({"edge", "modulus"})
      ->Args({55, 50000})
      ->Args({55, 5000000})
      ->Iterations(3)
      ->UseRealTime()
      ->Unit(benchmark::kMillisecond);
}
BENCHMARK_CAPTURE(large_dance, preview, NewtonSettings::preview())->Apply(large);
BENCHMARK_CAPTURE(large_dance, fine, NewtonSettings::fine())->Apply(large);
void parts(benchmark::internal::Benchmark* bench) {
  bench->ArgNames({"edge", "modulus"})->Args({185, 50000})->Args({100, 50000})->Unit(benchmark::kMicrosecond)->UseRealTime();
}
BENCHMARK(elastic_forces)->Apply(parts);
void cpu_parts(benchmark::internal::Benchmark* bench) {
  bench->ArgNames({"edge", "modulus"})->Args({185, 50000})->Args({100, 50000})->Unit(benchmark::kMicrosecond);
}
BENCHMARK_CAPTURE(backward_euler_force, double, BackwardEulerForce::Precision::kDouble)->Apply(cpu_parts);
BENCHMARK_CAPTURE(backward_euler_force, single, BackwardEulerForce::Precision::kSingle)->Apply(cpu_parts);
BENCHMARK_CAPTURE(elastic_stiffness, exact, Definiteness::kSymmetric)->Apply(parts);
BENCHMARK_CAPTURE(elastic_stiffness, convex, Definiteness::kConvex)->Apply(parts);
BENCHMARK_CAPTURE(elastic_stiffness, semidefinite, Definiteness::kSemidefinite)->Apply(parts);
BENCHMARK(factorization)->Apply(parts);
BENCHMARK(factor_solve)->Apply(parts);

}  // namespace
