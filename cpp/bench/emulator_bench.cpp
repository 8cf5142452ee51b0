// SPDX-License-Identifier: GPL-3.0-or-later
// Emulator::step with the published network's sizes on blocks of cubes, PatchNewton::step with the shipped schedule's on the
// dancer, and beside them in the same run what OpenBLAS' sgemm reaches and what the machine's registers can do. time_a_vertex is
// time a free vertex; multiply_adds_a_second counts those that remain after the exact savings, so its ratio to that of sgemm or
// registers_peak is the share of the machine that is used.
#include <benchmark/benchmark.h>
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "bfloat16_unit.hpp"
#include "dancer.hpp"
#include "followthrough/emulator/emulator.hpp"
#include "followthrough/emulator/patch_newton.hpp"
#include "instruction_set.hpp"

#if defined(__x86_64__)
#include <immintrin.h>
#endif
#if defined(__linux__)
#include <dlfcn.h>
#include <stdlib.h>
#endif

namespace {

using namespace followthrough;

Perceptron perceptron(std::mt19937& random, const std::vector<Eigen::Index>& widths) {
  Perceptron layers;
  for (std::size_t k = 1; k < widths.size(); ++k) {
    std::normal_distribution<float> number(0.0f, 1.0f / std::sqrt(static_cast<float>(widths[k - 1])));
    DenseLayer layer;
    layer.weight = layer.weight.NullaryExpr(widths[k], widths[k - 1], [&] { return number(random); });
    layer.bias = Eigen::VectorXf::Zero(widths[k]);
    layers.push_back(layer);
  }
  layers.back().weight *= 0.01f;
  return layers;
}

// The published sizes, or all of them divided.
PatchNetwork network(Eigen::Index divisor) {
  std::mt19937 random(1);
  const Eigen::Index point = 64 / divisor, edge = 128 / divisor, joined = point + edge;
  PatchNetwork weights;
  weights.inertia = perceptron(random, {18, point, point, point, point, point});
  weights.forces.push_back(perceptron(random, {37, edge, edge, edge, edge, edge}));
  weights.displacement = perceptron(random, {joined, joined, joined, joined, joined, 3});
  return weights;
}

// A cube of cubes without its constrained bottom has about so many vertices.
EmulatedBody block(Eigen::Index vertices) {
  const int side = std::max(2, static_cast<int>(std::lround(std::cbrt(static_cast<double>(vertices)))));
  const auto vertex = [&](int x, int y, int z) { return static_cast<Index>((x * side + y) * side + z); };
  EmulatedBody body;
  body.rest_positions.resize(side * side * side, 3);
  body.constrained.resize(body.rest_positions.rows());
  for (int x = 0; x < side; ++x) {
    for (int y = 0; y < side; ++y) {
      for (int z = 0; z < side; ++z) {
        body.rest_positions.row(vertex(x, y, z)) << 0.2 * x, 0.2 * y, 0.2 * z;
        body.constrained[vertex(x, y, z)] = x == 0;
      }
    }
  }
  const int cells = side - 1;
  const int cube[6][4] = {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}};  // bits: x y z
  body.tets.resize(6 * cells * cells * cells, 4);
  Eigen::Index tet = 0;
  for (int x = 0; x < cells; ++x) {
    for (int y = 0; y < cells; ++y) {
      for (int z = 0; z < cells; ++z) {
        for (const auto& corners : cube) {
          for (int k = 0; k < 4; ++k) {
            body.tets(tet, k) = vertex(x + (corners[k] >> 2), y + (corners[k] >> 1 & 1), z + (corners[k] & 1));
          }
          ++tet;
        }
      }
    }
  }
  body.youngs_modulus = Vector::Constant(body.rest_positions.rows(), 5e4);
  body.density = Vector::Constant(body.rest_positions.rows(), 1000.0);
  body.dt = std::sqrt(0.001);
  return body;
}

bool available(InstructionSet set) {
  const std::vector<InstructionSet> sets = available_instruction_sets();
  return std::find(sets.begin(), sets.end(), set) != sets.end();
}

void emulator_step(benchmark::State& state, InstructionSet set, Eigen::Index divisor, Precision precision = Precision::float32) {
  if (!available(set) || (precision == Precision::bfloat16 && bfloat16_unit() == Bfloat16Unit::none)) {
    state.SkipWithError("not available on this machine");
    return;
  }
  const InstructionSet usual = instruction_set();
  const int usual_threads = omp_get_max_threads();
  use_instruction_set(set);
  omp_set_num_threads(static_cast<int>(state.range(1)));
  const EmulatedBody body = block(state.range(0));
  Emulator emulator(body, network(divisor), {}, precision);
  emulator.reset(body.rest_positions);
  Positions reference = body.rest_positions;
  int frame = 0;
  for (auto _ : state) {
    reference.col(0) = body.rest_positions.col(0).array() + 0.2 * std::sin(0.3 * ++frame);
    benchmark::DoNotOptimize(emulator.step(reference).data());
  }
  const auto free = static_cast<double>(emulator.free_vertex_count()), steps = static_cast<double>(state.iterations());
  state.counters["free"] = free;
  state.counters["neighbours"] = static_cast<double>(emulator.edge_count()) / free;
  state.counters["time_a_vertex"] = benchmark::Counter(free * steps, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
  state.counters["multiply_adds_a_second"] = benchmark::Counter(emulator.multiply_adds() * steps, benchmark::Counter::kIsRate);
  omp_set_num_threads(usual_threads);
  use_instruction_set(usual);
}

// A guide of the shipped widths that says the first of its vectors, whatever it is told.
Guide guide_along_first(GuideSize size, float share) {
  std::mt19937 random(1);
  Guide guide = perceptron(random, {size.vectors * (size.vectors + 1) / 2 + size.scalars, 24, 24, size.vectors});
  guide.back().weight.setZero();
  guide.back().bias.setZero();
  guide.back().bias[0] = share;
  return guide;
}

// Three passes of 32 iterations, which is what a frame takes in the mean, so that sizes and threads compare. The modulus is such
// that the dimensionless stiffness is the same at every size.
void shipped_step(benchmark::State& state, InstructionSet set) {
  if (!available(set)) {
    state.SkipWithError("not available on this machine");
    return;
  }
  const InstructionSet usual = instruction_set();
  const int usual_threads = omp_get_max_threads();
  use_instruction_set(set);
  omp_set_num_threads(static_cast<int>(state.range(1)));
  const double edge = 1e-4 * static_cast<double>(state.range(0));
  const Dancer dancer(edge);
  NewtonBody body{{dancer.rest, dancer.tets, dancer.constrained, {}, {}, Dancer::dt}};
  body.youngs_modulus = Vector::Constant(dancer.rest.rows(), 5e4 * edge * edge / 0.04);
  body.density = Vector::Constant(dancer.rest.rows(), 1000.0);
  NewtonSchedule schedule;
  schedule.start = guide_along_first(start_guide_size(), 0.5f);
  schedule.passes.push_back({32, guide_along_first(pass_guide_size(), 1.0f)});
  schedule.most_passes = 3;
  schedule.tolerance = 0.0;
  PatchNewton emulator(body, schedule);
  emulator.reset(dancer.reference(0));
  std::vector<Positions> references;
  for (int frame = 1; frame <= 32; ++frame) references.push_back(dancer.reference(frame));
  std::size_t frame = 0;
  for (auto _ : state) benchmark::DoNotOptimize(emulator.step(references[frame++ % references.size()]).data());
  const auto free = static_cast<double>(emulator.free_vertex_count()), steps = static_cast<double>(state.iterations());
  state.counters["free"] = free;
  state.counters["time_a_vertex"] = benchmark::Counter(free * steps, benchmark::Counter::kIsRate | benchmark::Counter::kInvert);
  omp_set_num_threads(usual_threads);
  use_instruction_set(usual);
}

#if defined(__x86_64__)
// Chains of multiply-adds, more than any processor needs to hide their latency, that never leave the registers.
constexpr int chains = 12, rounds = 1000;

__attribute__((target("avx512f"))) float peak_avx512(float start) {
  __m512 sums[chains];
  for (auto& sum : sums) sum = _mm512_set1_ps(start);
  const __m512 factor = _mm512_set1_ps(0.999f), step = _mm512_set1_ps(start);
  for (int round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (auto& sum : sums) sum = _mm512_fmadd_ps(sum, factor, step);
  }
  for (auto& sum : sums) sums[0] = _mm512_add_ps(sums[0], sum);
  return _mm512_cvtss_f32(sums[0]);
}

__attribute__((target("avx2,fma"))) float peak_avx2(float start) {
  __m256 sums[chains];
  for (auto& sum : sums) sum = _mm256_set1_ps(start);
  const __m256 factor = _mm256_set1_ps(0.999f), step = _mm256_set1_ps(start);
  for (int round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (auto& sum : sums) sum = _mm256_fmadd_ps(sum, factor, step);
  }
  for (auto& sum : sums) sums[0] = _mm256_add_ps(sums[0], sum);
  return _mm256_cvtss_f32(sums[0]);
}

float peak_baseline(float start) {
  __m128 sums[chains];
  for (auto& sum : sums) sum = _mm_set1_ps(start);
  const __m128 factor = _mm_set1_ps(0.999f), step = _mm_set1_ps(start);
  for (int round = 0; round < rounds; ++round) {
#pragma GCC unroll 12
    for (auto& sum : sums) sum = _mm_add_ps(_mm_mul_ps(sum, factor), step);
  }
  for (auto& sum : sums) sums[0] = _mm_add_ps(sums[0], sum);
  return _mm_cvtss_f32(sums[0]);
}

void registers_peak(benchmark::State& state, InstructionSet set) {
  if (!available(set)) {
    state.SkipWithError("not available on this machine");
    return;
  }
  auto* const peak = set == InstructionSet::avx512 ? peak_avx512 : set == InstructionSet::avx2 ? peak_avx2 : peak_baseline;
  const double lanes = set == InstructionSet::avx512 ? 16 : set == InstructionSet::avx2 ? 8 : 4;
  float start = 1.0f;
  for (auto _ : state) {
    benchmark::DoNotOptimize(start);
    benchmark::DoNotOptimize(peak(start));
  }
  state.counters["multiply_adds_a_second"] =
      benchmark::Counter(lanes * chains * rounds * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

BENCHMARK_CAPTURE(registers_peak, baseline, InstructionSet::baseline);
BENCHMARK_CAPTURE(registers_peak, avx2, InstructionSet::avx2);
BENCHMARK_CAPTURE(registers_peak, avx512, InstructionSet::avx512);
#endif

#if defined(__linux__)
// Row major, no transposes: c = a b of n x n.
using Sgemm = void (*)(int, int, int, int, int, int, float, const float*, int, const float*, int, float, float*, int);

// From a shared library, so that nothing has to be there to build. OpenBLAS takes processors that it does not know for very old
// ones: it is told that this one has AVX-512.
Sgemm openblas_sgemm() {
  if (available(InstructionSet::avx512)) setenv("OPENBLAS_CORETYPE", "SKYLAKEX", 0);
  void* library = dlopen("libopenblas.so.0", RTLD_NOW);
  if (!library) return nullptr;
  if (void* threads = dlsym(library, "openblas_set_num_threads")) reinterpret_cast<void (*)(int)>(threads)(1);
  return reinterpret_cast<Sgemm>(dlsym(library, "cblas_sgemm"));
}

void sgemm(benchmark::State& state) {
  static const Sgemm multiply = openblas_sgemm();
  if (!multiply) {
    state.SkipWithError("OpenBLAS is not there (Debian: libopenblas0)");
    return;
  }
  const auto n = static_cast<int>(state.range(0));
  const auto size = static_cast<std::size_t>(n) * static_cast<std::size_t>(n);
  const std::vector<float> a(size, 0.5f), b(size, 0.25f);
  std::vector<float> c(size);
  for (auto _ : state) {
    multiply(101, 111, 111, n, n, n, 1.0f, a.data(), n, b.data(), n, 0.0f, c.data(), n);
    benchmark::DoNotOptimize(c.data());
    benchmark::ClobberMemory();
  }
  state.counters["multiply_adds_a_second"] =
      benchmark::Counter(static_cast<double>(size) * n * static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}

BENCHMARK(sgemm)->Arg(256)->Arg(512)->Arg(1536)->UseRealTime()->Unit(benchmark::kMillisecond);
#endif

void one_thread(benchmark::internal::Benchmark* bench) {
  bench->Args({1500, 1})->ArgNames({"vertices", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
}
void sizes(benchmark::internal::Benchmark* bench) {
  bench->ArgsProduct({{400, 1000, 1500, 4000, 10000, 40000}, {1, 2}});
  bench->ArgNames({"vertices", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
}

BENCHMARK_CAPTURE(emulator_step, published_baseline, InstructionSet::baseline, 1)->Apply(one_thread);
BENCHMARK_CAPTURE(emulator_step, published_avx2, InstructionSet::avx2, 1)->Apply(one_thread);
BENCHMARK_CAPTURE(emulator_step, published_avx512, InstructionSet::avx512, 1)->Apply(sizes);
BENCHMARK_CAPTURE(emulator_step, published_bfloat16, InstructionSet::avx512, 1, Precision::bfloat16)->Apply(sizes);
BENCHMARK_CAPTURE(emulator_step, half_width_avx512, InstructionSet::avx512, 2)->Apply(one_thread);
BENCHMARK_CAPTURE(emulator_step, quarter_width_avx512, InstructionSet::avx512, 4)->Apply(one_thread);

// About 1,100, 1,700, 3,800, 10,000 and 40,000 free vertices.
void edges(benchmark::internal::Benchmark* bench) {
  bench->ArgsProduct({{2000, 1700, 1250, 875, 530}, {1, 2}});
  bench->ArgNames({"edge_tenth_mm", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
}
void one_edge(benchmark::internal::Benchmark* bench) {
  bench->Args({1700, 1})->ArgNames({"edge_tenth_mm", "threads"})->UseRealTime()->Unit(benchmark::kMillisecond);
}

BENCHMARK_CAPTURE(shipped_step, baseline, InstructionSet::baseline)->Apply(one_edge);
BENCHMARK_CAPTURE(shipped_step, avx2, InstructionSet::avx2)->Apply(one_edge);
BENCHMARK_CAPTURE(shipped_step, avx512, InstructionSet::avx512)->Apply(edges);

}  // namespace
