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
    const auto since = Clock::now();
    while (!is_over()) std::this_thread::yield();
    const auto now = Clock::now();
    if (now - since > long_wait) {
      const auto waited = waited_.fetch_add((now - since).count(), std::memory_order_relaxed) + (now - since).count();
      if (Clock::duration(waited / team) > tolerated_waits + (now - forgotten_) / 10)
        crowded_.store(true, std::memory_order_relaxed);
    }
  }

  /// Whether each thread has waited for the others so long since `forget`, beside the time that has passed, that one alone would
  /// have been sooner: they have no processor each. Shares of work that differ are another matter.
  bool crowded() const noexcept { return crowded_.load(std::memory_order_relaxed); }
  void forget() noexcept {
    waited_.store(0, std::memory_order_relaxed);
    crowded_.store(false, std::memory_order_relaxed);
    forgotten_ = Clock::now();
  }

 private:
  using Clock = std::chrono::steady_clock;
  static constexpr int patience = 5000;  // microseconds: on an idle machine the others are there by then
  static constexpr std::chrono::microseconds long_wait{500}, tolerated_waits{1000};
  std::atomic<int> arrived_{0};
  std::atomic<Clock::rep> waited_{0};
  std::atomic<bool> crowded_{false};
  std::atomic<unsigned> round_{0};
  Clock::time_point forgotten_ = Clock::now();
};

/// The thread's share of `count` items, [first, last): the same items every time, so that they stay in its processor's caches.
struct TeamShare {
  explicit TeamShare(int count)
      : first(count * omp_get_thread_num() / omp_get_num_threads()),
        last(count * (omp_get_thread_num() + 1) / omp_get_num_threads()) {}
  int first, last;
};

}  // namespace followthrough
