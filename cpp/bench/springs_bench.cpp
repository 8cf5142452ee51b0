// SPDX-License-Identifier: GPL-3.0-or-later
// Springs::step at several mesh sizes and thread counts. Bytes counted are those that one step cannot do without, each array once:
// read position, velocity, the references of four frames and six factors (192 bytes a vertex), write position, velocity and one
// reference (72). The pass that checks the references for NaN reads 48 more, which are not counted. memory_copy of as many bytes is
// timed beside each size: the ratio of the two bytes_per_second is the share of copy speed.
#include <benchmark/benchmark.h>
#include <omp.h>

#include <algorithm>
#include <cstring>
#include <vector>

#include "followthrough/springs/springs.hpp"
#include "instruction_set.hpp"

namespace {

using namespace followthrough;

constexpr std::int64_t bytes_a_vertex = (6 * 3 + 6) * 8 + 3 * 3 * 8;

void springs_step(benchmark::State& state, InstructionSet set) {
  const std::vector<InstructionSet> sets = available_instruction_sets();
  if (std::find(sets.begin(), sets.end(), set) == sets.end()) {
    state.SkipWithError("not available on this machine");
    return;
  }
  const InstructionSet usual = instruction_set();
  const int usual_threads = omp_get_max_threads();
  use_instruction_set(set);
  omp_set_num_threads(static_cast<int>(state.range(1)));
  const Eigen::Index count = state.range(0);
  const Vector stiffness = Vector::LinSpaced(count, 80.0, 2000.0);
  const Vector damping = Vector::LinSpaced(count, 1.0, 20.0);
  Springs springs(stiffness, damping, 1.0 / 24.0);
  std::vector<Positions> references;
  for (int frame = 0; frame < 3; ++frame) {
    references.push_back(Positions::Random(count, 3));
  }
  springs.reset(references[0]);
  std::size_t frame = 0;
  for (auto _ : state) {
    frame = (frame + 1) % 3;
    benchmark::DoNotOptimize(springs.step(references[frame], &references[(frame + 1) % 3]).data());
  }
  state.SetItemsProcessed(static_cast<std::int64_t>(state.iterations()) * count);
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations()) * count * bytes_a_vertex);
  omp_set_num_threads(usual_threads);
  use_instruction_set(usual);
}

// As many bytes as a step of so many vertices moves, half read and half written, by as many threads.
void springs_memory_copy(benchmark::State& state) {
  const auto threads = static_cast<int>(state.range(1));
  const std::int64_t bytes = state.range(0) * bytes_a_vertex / 2;
  std::vector<char> source(static_cast<std::size_t>(bytes), 1), target(static_cast<std::size_t>(bytes), 2);
  for (auto _ : state) {
#pragma omp parallel for schedule(static) num_threads(threads) if (threads > 1)
    for (int t = 0; t < threads; ++t) {
      const std::int64_t first = bytes * t / threads, last = bytes * (t + 1) / threads;
      std::memcpy(target.data() + first, source.data() + first, static_cast<std::size_t>(last - first));
    }
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<std::int64_t>(state.iterations()) * bytes * 2);
}

void sizes(benchmark::internal::Benchmark* bench) {
  bench->ArgsProduct({{1500, 14000, 100000, 1000000}, {1, 2}})->ArgNames({"vertices", "threads"})->UseRealTime();
}

BENCHMARK(springs_memory_copy)->Apply(sizes);
BENCHMARK_CAPTURE(springs_step, baseline, InstructionSet::baseline)->Apply(sizes);
BENCHMARK_CAPTURE(springs_step, avx2, InstructionSet::avx2)->Apply(sizes);
BENCHMARK_CAPTURE(springs_step, avx512, InstructionSet::avx512)->Apply(sizes);

}  // namespace
