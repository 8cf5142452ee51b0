// SPDX-License-Identifier: GPL-3.0-or-later
#include "motion/motion_worker.hpp"

#include <omp.h>

#include <algorithm>
#include <utility>

#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

using Clock = std::chrono::steady_clock;

/// So many frames are solved before the surface of the oldest one is shown, where there are as many: one for each of two threads.
constexpr std::ptrdiff_t solved_ahead = 2;

/// How many threads the parallel regions of this thread have, for as long as it lives.
class ThreadCount {
 public:
  explicit ThreadCount(int threads) : before_(omp_get_max_threads()) {
    if (threads > 0) omp_set_num_threads(threads);
  }
  ~ThreadCount() { omp_set_num_threads(before_); }
  ThreadCount(const ThreadCount&) = delete;
  ThreadCount& operator=(const ThreadCount&) = delete;

 private:
  int before_;
};

}  // namespace

RiggedMotion::Worker::Worker(RiggedMotion& motion, int threads) : motion_(motion), threads_(threads), thread_([this] { run(); }) {}

RiggedMotion::Worker::~Worker() {
  {
    const std::lock_guard lock(mutex_);
    closing_ = true;
  }
  changed_.notify_all();
  thread_.join();
}

bool RiggedMotion::Worker::idle() const {
  const std::lock_guard lock(mutex_);
  return frames_.empty();
}

void RiggedMotion::Worker::begin(const RigPose& pose, std::unique_ptr<RigPose> next, float* offsets) {
  {
    const std::lock_guard lock(mutex_);
    frames_.push_back({pose, std::move(next), offsets});
  }
  changed_.notify_all();
}

bool RiggedMotion::Worker::wait(double seconds) {
  std::unique_lock lock(mutex_);
  return frames_.empty() ||
         help_until_done(lock, Clock::now() + std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(seconds)));
}

MotionFrame RiggedMotion::Worker::finish() {
  std::unique_lock lock(mutex_);
  if (frames_.empty()) throw InvalidInput("pose", "found no frame under way, expected begin to be called first");
  help_until_done(lock, Clock::time_point::max());
  if (const std::exception_ptr error = frames_.front().error) {
    drop(lock);
    std::rethrow_exception(error);
  }
  MotionFrame result = std::move(frames_.front().result);
  frames_.pop_front();
  return result;
}

void RiggedMotion::Worker::abandon() {
  std::unique_lock lock(mutex_);
  drop(lock);
}

void RiggedMotion::Worker::run() {
  const ThreadCount count(threads_);
  std::unique_lock lock(mutex_);
  while (!closing_) {
    Frame* const next = failed_ ? nullptr : first(Stage::begun);
    Frame* const solved = first(Stage::solved);
    const auto ahead = std::count_if(frames_.begin(), frames_.end(), [](const Frame& f) { return f.stage == Stage::solved; });
    if (next && ahead < solved_ahead) {
      solve(*next, lock);
    } else if (solved) {
      show(*solved, lock);
    } else {
      changed_.wait(lock);
    }
  }
}

/// The oldest frame in this stage, or null; frames keep their place in memory until they are finished.
RiggedMotion::Worker::Frame* RiggedMotion::Worker::first(Stage stage) {
  const auto found = std::find_if(frames_.begin(), frames_.end(), [stage](const Frame& f) { return f.stage == stage; });
  return found == frames_.end() ? nullptr : &*found;
}

void RiggedMotion::Worker::solve(Frame& frame, std::unique_lock<std::mutex>& lock) {
  frame.stage = Stage::at_work;
  lock.unlock();
  try {
    frame.moved = motion_.solve(frame.pose, frame.next.get());
  } catch (...) {
    frame.error = std::current_exception();
  }
  lock.lock();
  failed_ |= frame.error != nullptr;
  frame.stage = frame.error ? Stage::done : Stage::solved;
  if (frame.stage == Stage::solved && !first(Stage::begun)) show(frame, lock);  // the last one: nothing else to do here
  changed_.notify_all();
}

void RiggedMotion::Worker::show(Frame& frame, std::unique_lock<std::mutex>& lock) {
  frame.stage = Stage::at_work;
  lock.unlock();
  try {
    frame.result = motion_.show(frame.pose, frame.moved, frame.offsets);
  } catch (...) {
    frame.error = std::current_exception();
  }
  lock.lock();
  failed_ |= frame.error != nullptr;
  frame.stage = Stage::done;
  changed_.notify_all();
}

/// Works on what there is until the oldest frame is done, or the time has come; returns whether it is.
bool RiggedMotion::Worker::help_until_done(std::unique_lock<std::mutex>& lock, Clock::time_point until) {
  const ThreadCount count(threads_);
  while (frames_.front().stage != Stage::done) {
    if (Clock::now() >= until) return false;
    if (Frame* const solved = first(Stage::solved)) {
      show(*solved, lock);
    } else if (until == Clock::time_point::max()) {
      changed_.wait(lock);
    } else {
      changed_.wait_until(lock, until);
    }
  }
  return true;
}

/// Forgets all frames, once none of them is at work.
void RiggedMotion::Worker::drop(std::unique_lock<std::mutex>& lock) {
  for (Frame& frame : frames_) {
    if (frame.stage != Stage::at_work) frame.stage = Stage::done;
  }
  changed_.wait(lock, [this] { return !first(Stage::at_work); });
  frames_.clear();
  failed_ = false;
}

}  // namespace followthrough
