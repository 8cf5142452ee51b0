// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Where the threads of a parallel region wait for each other every few microseconds. OpenMP's own barrier may keep its processor
/// while it waits: on a busy machine, where the thread that it waits for has none, each one then takes a whole time slice.
#pragma once

#include <omp.h>

#include <atomic>
#include <condition_variable>
#include <mutex>

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
      const std::lock_guard lock(mutex_);
      ++rounds_;
      round_.store(round + 1, std::memory_order_release);
      if (sleepers_ > 0) woken_.notify_all();
      return;
    }
    const auto is_over = [&] { return round_.load(std::memory_order_acquire) != round; };
    for (int tries = 0; tries < patience; ++tries) {
      if (is_over()) return;
    }
    std::unique_lock lock(mutex_);
    ++sleepers_;
    ++sleeps_;
    woken_.wait(lock, is_over);
    --sleepers_;
  }

  /// Whether, since the last call, threads have waited long for each other so often that one alone would have been sooner: they had
  /// no processor each. Not to be called in a parallel region.
  bool was_crowded() noexcept {
    const bool crowded = sleeps_ > rounds_ / 8 + 8;
    sleeps_ = rounds_ = 0;
    return crowded;
  }

 private:
  static constexpr int patience = 5000;  // microseconds: on an idle machine the others are there by then
  std::atomic<int> arrived_{0};
  std::atomic<unsigned> round_{0};
  std::mutex mutex_;
  std::condition_variable woken_;
  int sleepers_ = 0, sleeps_ = 0, rounds_ = 0;
};

/// The thread's share of `count` items, [first, last): the same items every time, so that they stay in its processor's caches.
struct TeamShare {
  explicit TeamShare(int count)
      : first(count * omp_get_thread_num() / omp_get_num_threads()),
        last(count * (omp_get_thread_num() + 1) / omp_get_num_threads()) {}
  int first, last;
};

}  // namespace followthrough
