// SPDX-License-Identifier: GPL-3.0-or-later
// Memory copy speed of this machine in this run: the yardstick beside every bandwidth-bound figure.
#include <benchmark/benchmark.h>

#include <cstring>
#include <vector>

static void memory_copy(benchmark::State& state) {
  const auto bytes = static_cast<std::size_t>(state.range(0));
  std::vector<char> source(bytes, 1), target(bytes, 2);
  for (auto _ : state) {
    std::memcpy(target.data(), source.data(), bytes);
    benchmark::ClobberMemory();
  }
  state.SetBytesProcessed(static_cast<int64_t>(state.iterations()) * static_cast<int64_t>(2 * bytes));
}
BENCHMARK(memory_copy)->Arg(1 << 20)->Arg(16 << 20)->Arg(256 << 20);
