// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/motion/rigged_motion.hpp"

#include <omp.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <optional>
#include <thread>
#include <utility>

#include <Eigen/LU>

#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "motion/surface_offsets.hpp"
#include "skinning/bone_blend.hpp"
#include "skinning/stretch_solve.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::RowVector3d;
using Eigen::Vector3d;

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// What a vertex takes in the linear kernel, roughly, beside its places (see worthwhile_threads).
constexpr double linear_offset_nanoseconds = 10;

auto surface_kernel() {
  switch (instruction_set()) {
#ifdef FOLLOWTHROUGH_HAS_avx512
    case InstructionSet::avx512:
      return avx512::surface_offsets;
#endif
#ifdef FOLLOWTHROUGH_HAS_avx2
    case InstructionSet::avx2:
      return avx2::surface_offsets;
#endif
    default:
      return baseline::surface_offsets;
  }
}

/// Writes the offset that shows a vertex's displacement; returns false where that cannot be done with finite numbers.
bool offset_of(const BoneBlend& blend, Eigen::Index vertex, double minimum_stretch, const Matrix3d& to_world,
               const Matrix3d& to_object, MotionFrame& frame, double& residual_squared) {
  bool valid = true;
  const Matrix3d jacobian = blend.vertex_transform(vertex, valid).linear;
  const Vector3d wanted = to_object * frame.displacements.row(vertex).transpose();
  const Vector3d offset = stretch_solve(jacobian, wanted, minimum_stretch);
  frame.offsets.row(vertex) = offset;
  residual_squared = std::max(residual_squared, (to_world * (wanted - jacobian * offset)).squaredNorm());
  return valid && offset.allFinite();
}

SurfaceShare linear_offsets(const RiggedCharacter& character, const Tets& corners, const BoneBlend& blend, const BoneRows& bones,
                            const Positions& moved, const Matrix3d& to_world, const Matrix3d& to_object, MotionFrame& frame) {
  Weights4 padded(moved.rows(), 4);
  padded.leftCols<3>() = moved;
  padded.col(3).setZero();
  SurfaceFrame surface{padded.data(),
                       corners.data(),
                       character.embedding.weights.data(),
                       bones,
                       least_total_weight,
                       {},
                       {},
                       character.minimum_stretch,
                       frame.displacements.data(),
                       frame.offsets.data()};
  Eigen::Map<RowMatrix3>(surface.to_object) = to_object;
  Eigen::Map<RowMatrix3>(surface.to_world) = to_world;
  const auto kernel = surface_kernel();

  constexpr Eigen::Index share = 1024;  // vertices
  const Eigen::Index count = blend.vertex_count();
  const Eigen::Index shares = (count + share - 1) / share;
  int unusable = 0;
  double displacement_squared = 0.0;
  double residual_squared = 0.0;
  const int threads = worthwhile_threads(count, linear_offset_nanoseconds + 2.0 * static_cast<double>(bones.places));
#pragma omp parallel for schedule(static) num_threads(threads) reduction(| : unusable) \
    reduction(max : displacement_squared, residual_squared)
  for (Eigen::Index index = 0; index < shares; ++index) {
    std::array<Index, share> flattened;
    const SurfaceShare done = kernel(surface, index * share, std::min((index + 1) * share, count), flattened.data());
    unusable |= !done.usable;
    displacement_squared = std::max(displacement_squared, done.displacement_squared);
    residual_squared = std::max(residual_squared, done.residual_squared);
    for (std::int64_t k = 0; k < done.flattened; ++k) {
      const Eigen::Index vertex = flattened[static_cast<std::size_t>(k)];
      unusable |= !offset_of(blend, vertex, character.minimum_stretch, to_world, to_object, frame, residual_squared);
    }
  }
  return {unusable == 0, displacement_squared, residual_squared};
}

SurfaceShare any_offsets(const RiggedCharacter& character, const Tets& corners, const BoneBlend& blend, const Positions& moved,
                         const Matrix3d& to_world, const Matrix3d& to_object, MotionFrame& frame) {
  int unusable = 0;
  double displacement_squared = 0.0;
  double residual_squared = 0.0;
  const Eigen::Index count = blend.vertex_count();
  const int threads = worthwhile_threads(count, 10 + blend.nanoseconds() + stretch_solve_nanoseconds);
#pragma omp parallel for schedule(static) num_threads(threads) reduction(| : unusable) \
    reduction(max : displacement_squared, residual_squared)
  for (Eigen::Index vertex = 0; vertex < count; ++vertex) {
    const auto tet = corners.row(vertex);
    const auto weights = character.embedding.weights.row(vertex);
    const RowVector3d displacement = weights[0] * moved.row(tet[0]) + weights[1] * moved.row(tet[1]) +
                                     weights[2] * moved.row(tet[2]) + weights[3] * moved.row(tet[3]);
    frame.displacements.row(vertex) = displacement;
    const double length_squared = displacement.squaredNorm();
    if (length_squared == 0.0) {  // pinned: most of a character
      frame.offsets.row(vertex).setZero();
      continue;
    }
    displacement_squared = std::max(displacement_squared, length_squared);
    unusable |= !offset_of(blend, vertex, character.minimum_stretch, to_world, to_object, frame, residual_squared);
  }
  return {unusable == 0, displacement_squared, residual_squared};
}

bool same(const RigPose& a, const RigPose& b) {
  return a.bone_matrices.rows() == b.bone_matrices.rows() && a.bone_matrices == b.bone_matrices && a.armature == b.armature &&
         a.world == b.world;
}

}  // namespace

/// One thread, with helpers where it may have some, that takes one frame at a time.
class RiggedMotion::Worker {
 public:
  explicit Worker(int threads) : thread_([this, threads] { run(threads); }) {}
  ~Worker() {
    {
      const std::lock_guard lock(mutex_);
      closing_ = true;
    }
    changed_.notify_all();
    thread_.join();
  }
  Worker(const Worker&) = delete;
  Worker& operator=(const Worker&) = delete;

  void begin(RiggedMotion& motion, const RigPose& pose, std::unique_ptr<RigPose> next) {
    {
      const std::lock_guard lock(mutex_);
      if (motion_) throw InvalidInput("pose", "found a frame under way, expected finish to be called first");
      motion_ = &motion;
      pose_ = pose;
      next_ = std::move(next);
      result_.reset();
      error_ = nullptr;
    }
    changed_.notify_all();
  }

  bool wait(double seconds) {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, std::chrono::duration<double>(seconds), [this] { return !motion_ || result_ || error_; });
  }

  MotionFrame finish() {
    std::unique_lock lock(mutex_);
    if (!motion_) throw InvalidInput("pose", "found no frame under way, expected begin to be called first");
    changed_.wait(lock, [this] { return result_ || error_; });
    motion_ = nullptr;
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
    return std::move(*result_);
  }

 private:
  void run(int threads) {
    if (threads > 0) omp_set_num_threads(threads);  // of this thread's own parallel regions
    std::unique_lock lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return closing_ || (motion_ && !result_ && !error_); });
      if (closing_) return;
      lock.unlock();
      std::optional<MotionFrame> result;
      std::exception_ptr error;
      try {
        result = motion_->step(pose_, next_.get());
      } catch (...) {
        error = std::current_exception();
      }
      lock.lock();
      result_ = std::move(result);
      error_ = error;
      changed_.notify_all();
    }
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  bool closing_ = false;
  RiggedMotion* motion_ = nullptr;  // the frame under way
  RigPose pose_;
  std::unique_ptr<RigPose> next_;
  std::optional<MotionFrame> result_;
  std::exception_ptr error_;
  std::thread thread_;  // last: it uses all of the above
};

RiggedMotion::RiggedMotion(RiggedCharacter character, Solver& solver, int threads)
    : character_(std::move(character)), solver_(solver), threads_(threads) {
  const Eigen::Index volume = character_.volume_rest_positions.rows();
  require_rows("volume_bones", character_.volume_bones.rows(), volume);
  require_rows("volume_weights", character_.volume_weights.rows(), volume);
  require_rows("solver", solver_.vertex_count(), volume);
  require_indices("tets", character_.tets, volume);
  require_indices("embedding_tets", character_.embedding.tets, character_.tets.rows());
  const Eigen::Index surface = character_.embedding.tets.rows();
  require_rows("embedding_weights", character_.embedding.weights.rows(), surface);
  require_rows("surface_bones", character_.surface_bones.rows(), surface);
  require_rows("surface_weights", character_.surface_weights.rows(), surface);
  corners_.resize(surface, 4);
  for (Eigen::Index vertex = 0; vertex < surface; ++vertex)
    corners_.row(vertex) = character_.tets.row(character_.embedding.tets[vertex]);
  if (!(std::isfinite(character_.minimum_stretch) && character_.minimum_stretch > 0.0)) {
    throw InvalidInput("minimum_stretch", "expected a finite number above 0");
  }
}

RiggedMotion::~RiggedMotion() = default;

Positions RiggedMotion::reference(const RigPose& pose) const {
  if (!pose.world.allFinite() || std::abs(pose.world.topLeftCorner<3, 3>().determinant()) <= 0.0) {
    throw InvalidInput("pose.world", "found a matrix that is not finite or flattens the object, expected an invertible one");
  }
  Positions posed = pose_vertices(character_.volume_rest_positions, {character_.volume_bones, character_.volume_weights},
                                  {pose.bone_matrices, character_.bone_rest_matrices, pose.armature}, character_.skinning);
  posed = (posed * pose.world.topLeftCorner<3, 3>().transpose()).rowwise() + pose.world.topRightCorner<3, 1>().transpose();
  return posed;
}

void RiggedMotion::reset(const RigPose& pose) {
  const Positions start = reference(pose);
  solver_.reset(start);
  ahead_reference_.resize(0, 3);
}

MotionFrame RiggedMotion::step(const RigPose& pose, const RigPose* next) {
  const bool known = ahead_reference_.rows() > 0 && same(pose, ahead_pose_);
  const Positions here = known ? std::move(ahead_reference_) : reference(pose);
  ahead_reference_.resize(0, 3);
  if (next) {
    ahead_reference_ = reference(*next);
    ahead_pose_ = *next;
  }
  const Positions moved = solver_.step(here, next ? &ahead_reference_ : nullptr) - here;

  const Matrix3d to_world = pose.world.topLeftCorner<3, 3>();
  const Matrix3d to_object = to_world.inverse();
  const BoneBlend blend({character_.surface_bones, character_.surface_weights},
                        {pose.bone_matrices, character_.bone_rest_matrices, pose.armature}, character_.skinning);
  const Eigen::Index count = blend.vertex_count();
  MotionFrame frame{Positions(count, 3), Positions(count, 3)};
  SurfaceShare found;
  if (const std::optional<BoneRows> bones = blend.linear_rows()) {
    found = linear_offsets(character_, corners_, blend, *bones, moved, to_world, to_object, frame);
  } else {
    found = any_offsets(character_, corners_, blend, moved, to_world, to_object, frame);
  }
  if (!found.usable || !std::isfinite(found.displacement_squared)) {
    blend.require_weights();
    throw InvalidInput("pose", "the motion is no longer finite");
  }
  frame.largest_displacement = std::sqrt(found.displacement_squared);
  frame.largest_residual = std::sqrt(found.residual_squared);
  return frame;
}

void RiggedMotion::begin(const RigPose& pose, std::unique_ptr<RigPose> next) {
  if (!worker_) worker_ = std::make_unique<Worker>(threads_);
  worker_->begin(*this, pose, std::move(next));
}

bool RiggedMotion::wait(double seconds) { return !worker_ || worker_->wait(seconds); }

MotionFrame RiggedMotion::finish() {
  if (!worker_) throw InvalidInput("pose", "found no frame under way, expected begin to be called first");
  return worker_->finish();
}

}  // namespace followthrough
