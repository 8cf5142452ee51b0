// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The frames of a motion that are under way beside its caller.
#pragma once

#include <chrono>
#include <condition_variable>
#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>

#include "followthrough/motion/rigged_motion.hpp"

namespace followthrough {

/// A thread that takes frames one after the other, in the order in which they were begun.
///
/// A frame has two halves: the solver's, which needs the frame before, and the surface's, which needs the solver's alone. So that
/// nobody is idle, the thread solves a little ahead, and whoever waits for a frame shows surfaces meanwhile. Each half is the same
/// work on whichever thread, so results do not depend on who did it.
class RiggedMotion::Worker {
 public:
  /// @param threads as RiggedMotion's
  Worker(RiggedMotion& motion, int threads);
  ~Worker();
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  bool idle() const;
  void begin(const RigPose& pose, std::unique_ptr<RigPose> next, float* offsets);
  bool wait(double seconds);
  MotionFrame finish();
  void abandon();

 private:
  enum class Stage { begun, solved, at_work, done };

  struct Frame {
    RigPose pose;
    std::unique_ptr<RigPose> next;
    float* offsets;
    Stage stage = Stage::begun;
    Weights4 moved{};
    MotionFrame result{};
    std::exception_ptr error{};
  };

  void run();
  Frame* first(Stage stage);
  void solve(Frame& frame, std::unique_lock<std::mutex>& lock);
  void show(Frame& frame, std::unique_lock<std::mutex>& lock);
  bool help_until_done(std::unique_lock<std::mutex>& lock, std::chrono::steady_clock::time_point until);
  void drop(std::unique_lock<std::mutex>& lock);

  RiggedMotion& motion_;
  const int threads_;
  mutable std::mutex mutex_;
  std::condition_variable changed_;
  bool closing_ = false;
  bool failed_ = false;       // a frame under way has an error: those after it are not solved
  std::deque<Frame> frames_;  // the oldest first
  std::thread thread_;        // last: it uses all of the above
};

}  // namespace followthrough
