// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/motion/rigged_motion.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include <Eigen/LU>

#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "motion/motion_worker.hpp"
#include "motion/surface_offsets.hpp"
#include "skinning/bone_blend.hpp"
#include "skinning/stretch_solve.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

using RowMatrix3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

/// What a vertex takes in the linear kernel, roughly, beside its places (see worthwhile_threads).
constexpr double linear_offset_nanoseconds = 10;

auto surface_kernel() { return FOLLOWTHROUGH_KERNEL(surface_offsets); }

/// Where the offsets of a frame go: rounded, or in double precision with the displacements beside them.
struct FrameOut {
  MotionFrame& frame;
  float* rounded;

  /// Returns false where the offset is not finite there.
  bool write(Eigen::Index vertex, const Vector3d& displacement, const Vector3d& offset) const {
    if (rounded) {
      const Eigen::Vector3f narrow = offset.cast<float>();
      Eigen::Map<Eigen::Vector3f>(rounded + 3 * vertex) = narrow;
      return narrow.allFinite();
    }
    frame.displacements.row(vertex) = displacement;
    frame.offsets.row(vertex) = offset;
    return offset.allFinite();
  }
};

Vector3d displacement_of(const Tets& corners, const Weights4& weights, const Weights4& moved, Eigen::Index vertex) {
  const auto tet = corners.row(vertex);
  const auto share = weights.row(vertex);
  return (share[0] * moved.row(tet[0]) + share[1] * moved.row(tet[1]) + share[2] * moved.row(tet[2]) + share[3] * moved.row(tet[3]))
      .head<3>();
}

/// Writes the offset that shows a vertex's displacement; returns false where that cannot be done with finite numbers.
bool write_offset(const BoneBlend& blend, Eigen::Index vertex, const Vector3d& displacement, double minimum_stretch,
                  const Matrix3d& to_world, const Matrix3d& to_object, const FrameOut& out, double& residual_squared) {
  bool valid = true;
  const Matrix3d jacobian = blend.vertex_transform(vertex, valid).linear;
  const Vector3d wanted = to_object * displacement;
  const Vector3d offset = stretch_solve(jacobian, wanted, minimum_stretch);
  residual_squared = std::max(residual_squared, (to_world * (wanted - jacobian * offset)).squaredNorm());
  return out.write(vertex, displacement, offset) && valid;
}

SurfaceShare linear_offsets(const RiggedCharacter& character, const Tets& corners, const BoneBlend& blend, const BoneRows& bones,
                            const Weights4& moved, const Matrix3d& to_world, const Matrix3d& to_object, const FrameOut& out) {
  SurfaceFrame surface{moved.data(),
                       corners.data(),
                       character.embedding.weights.data(),
                       bones,
                       least_total_weight,
                       {},
                       {},
                       character.minimum_stretch,
                       out.frame.displacements.data(),
                       out.frame.offsets.data(),
                       out.rounded};
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
      const Vector3d displacement = displacement_of(corners, character.embedding.weights, moved, vertex);
      unusable |= !write_offset(blend, vertex, displacement, character.minimum_stretch, to_world, to_object, out, residual_squared);
    }
  }
  return {unusable == 0, displacement_squared, residual_squared};
}

SurfaceShare any_offsets(const RiggedCharacter& character, const Tets& corners, const BoneBlend& blend, const Weights4& moved,
                         const Matrix3d& to_world, const Matrix3d& to_object, const FrameOut& out) {
  int unusable = 0;
  double displacement_squared = 0.0;
  double residual_squared = 0.0;
  const Eigen::Index count = blend.vertex_count();
  const int threads = worthwhile_threads(count, 10 + blend.nanoseconds() + stretch_solve_nanoseconds);
#pragma omp parallel for schedule(static) num_threads(threads) reduction(| : unusable) \
    reduction(max : displacement_squared, residual_squared)
  for (Eigen::Index vertex = 0; vertex < count; ++vertex) {
    const Vector3d displacement = displacement_of(corners, character.embedding.weights, moved, vertex);
    const double length_squared = displacement.squaredNorm();
    if (length_squared == 0.0) {  // pinned: most of a character
      out.write(vertex, displacement, Vector3d::Zero());
      continue;
    }
    displacement_squared = std::max(displacement_squared, length_squared);
    unusable |= !write_offset(blend, vertex, displacement, character.minimum_stretch, to_world, to_object, out, residual_squared);
  }
  return {unusable == 0, displacement_squared, residual_squared};
}

bool same(const RigPose& a, const RigPose& b) {
  return a.bone_matrices.rows() == b.bone_matrices.rows() && a.bone_matrices == b.bone_matrices && a.armature == b.armature &&
         a.world == b.world;
}

}  // namespace

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
  require_idle();
  const Positions start = reference(pose);
  solver_.reset(start);
  ahead_reference_.resize(0, 3);
}

MotionFrame RiggedMotion::step(const RigPose& pose, const RigPose* next) {
  require_idle();
  return show(pose, solve(pose, next), nullptr);
}

Weights4 RiggedMotion::solve(const RigPose& pose, const RigPose* next) {
  const bool known = ahead_reference_.rows() > 0 && same(pose, ahead_pose_);
  const Positions here = known ? std::move(ahead_reference_) : reference(pose);
  ahead_reference_.resize(0, 3);
  if (next) {
    ahead_reference_ = reference(*next);
    ahead_pose_ = *next;
  }
  Weights4 moved(here.rows(), 4);
  moved.leftCols<3>() = solver_.step(here, next ? &ahead_reference_ : nullptr) - here;
  moved.col(3).setZero();
  return moved;
}

MotionFrame RiggedMotion::show(const RigPose& pose, const Weights4& moved, float* rounded) const {
  const Matrix3d to_world = pose.world.topLeftCorner<3, 3>();
  const Matrix3d to_object = to_world.inverse();
  const BoneBlend blend({character_.surface_bones, character_.surface_weights},
                        {pose.bone_matrices, character_.bone_rest_matrices, pose.armature}, character_.skinning);
  const Eigen::Index kept = rounded ? 0 : blend.vertex_count();
  MotionFrame frame{Positions(kept, 3), Positions(kept, 3)};
  const FrameOut out{frame, rounded};
  SurfaceShare found;
  if (const std::optional<BoneRows> bones = blend.linear_rows()) {
    found = linear_offsets(character_, corners_, blend, *bones, moved, to_world, to_object, out);
  } else {
    found = any_offsets(character_, corners_, blend, moved, to_world, to_object, out);
  }
  if (!found.usable || !std::isfinite(found.displacement_squared)) {
    blend.require_weights();
    throw InvalidInput("pose", "the motion is no longer finite");
  }
  frame.largest_displacement = std::sqrt(found.displacement_squared);
  frame.largest_residual = std::sqrt(found.residual_squared);
  return frame;
}

void RiggedMotion::begin(const RigPose& pose, std::unique_ptr<RigPose> next, float* offsets) {
  if (!worker_) worker_ = std::make_unique<Worker>(*this, threads_);
  worker_->begin(pose, std::move(next), offsets);
}

bool RiggedMotion::wait(double seconds) { return !worker_ || worker_->wait(seconds); }

MotionFrame RiggedMotion::finish() {
  if (!worker_) throw InvalidInput("pose", "found no frame under way, expected begin to be called first");
  return worker_->finish();
}

void RiggedMotion::abandon() {
  if (worker_) worker_->abandon();
}

void RiggedMotion::require_idle() const {
  if (worker_ && !worker_->idle()) {
    throw InvalidInput("pose", "found a frame under way, expected finish to be called first");
  }
}

}  // namespace followthrough
