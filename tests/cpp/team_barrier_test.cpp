// SPDX-License-Identifier: GPL-3.0-or-later
#include "team_barrier.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <vector>

using namespace followthrough;

TEST_CASE("what threads write before a barrier all of them read after it, and shares leave nothing out") {
  constexpr int items = 37, rounds = 2000;
  for (const int threads : {1, 2, 3, 5}) {
    CAPTURE(threads);
    TeamBarrier barrier;
    std::vector<int> numbers(items, 0), next(items, 0);
    std::vector<long> sums(static_cast<std::size_t>(threads), 0);
#pragma omp parallel num_threads(threads)
    {
      const TeamShare share(items);
      for (int round = 0; round < rounds; ++round) {
        // Every item becomes one more than its neighbour, which another thread may have.
        for (int k = share.first; k < share.last; ++k)
          next[static_cast<std::size_t>(k)] = numbers[static_cast<std::size_t>((k + 1) % items)] + 1;
        barrier.wait();
        for (int k = share.first; k < share.last; ++k) numbers[static_cast<std::size_t>(k)] = next[static_cast<std::size_t>(k)];
        barrier.wait();
      }
      for (const int number : numbers) sums[static_cast<std::size_t>(omp_get_thread_num())] += number;
    }
    for (int k = 0; k < threads; ++k) CHECK(sums[static_cast<std::size_t>(k)] == long{items} * rounds);
    if (threads == 1) CHECK_FALSE(barrier.crowded());
  }
}
