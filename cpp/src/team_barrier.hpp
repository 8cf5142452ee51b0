// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Where the threads of a parallel region wait for each other every few microseconds. OpenMP's own barrier may keep its processor
/// while it waits: on a busy machine, where the thread that it waits for has none, each one then takes a whole time slice.
#pragma once

#include <omp.h>

#include <atomic>
#include <chrono>
#include <thread>

namespace followthrough {

class TeamBarrier {
 public:
  /// To be called by every thread of the innermost parallel region. What they wrote before it can be read after it.
  void wait() noexcept {
    const int team = omp_get_num_threads();
    if (team == 1) return;
    const unsigned round = round_.load(std::memory_order_relaxed);
    if (arrived_.fetch_add(1, std::memory_order_acq_rel) + 1 == team) {
      arrived_.store(0, std::memory_order_relaxed);
      round_.store(round + 1, std::memory_order_release);
      return;
    }
    const auto is_over = [&] { return round_.load(std::memory_order_acquire) != round; };
    for (int tries = 0; tries < patience; ++tries) {
      if (is_over()) return;
    }
    const auto since = std::chrono::steady_clock::now();
    while (!is_over()) std::this_thread::yield();
    if (std::chrono::steady_clock::now() - since > long_wait) long_waits_.fetch_add(1, std::memory_order_relaxed);
  }

  /// Whether threads have waited long for each other so often since `forget` that one alone would have been sooner: they have no
  /// processor each.
  bool crowded() const noexcept { return long_waits_.load(std::memory_order_relaxed) > tolerated_waits; }
  void forget() noexcept { long_waits_.store(0, std::memory_order_relaxed); }

 private:
  static constexpr int patience = 5000;  // microseconds: on an idle machine the others are there by then
  static constexpr int tolerated_waits = 8;
  static constexpr std::chrono::microseconds long_wait{500};
  std::atomic<int> arrived_{0}, long_waits_{0};
  std::atomic<unsigned> round_{0};
};

/// The thread's share of `count` items, [first, last): the same items every time, so that they stay in its processor's caches.
struct TeamShare {
  explicit TeamShare(int count)
      : first(count * omp_get_thread_num() / omp_get_num_threads()),
        last(count * (omp_get_thread_num() + 1) / omp_get_num_threads()) {}
  int first, last;
};

}  // namespace followthrough
