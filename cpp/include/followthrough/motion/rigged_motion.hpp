// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A rigged character's way through one frame, from the bones' pose to the offsets of its rest shape: reference, solver, embedding
/// and inverse skinning in one pass, on the caller's thread or on one of its own while the caller prepares the next poses.
#pragma once

#include <memory>

#include "followthrough/mesh/embedding.hpp"
#include "followthrough/skinning/skinning.hpp"
#include "followthrough/solver.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

/// What stays the same over all frames. See BoneWeights and PosedBones for the tables and matrices.
struct RiggedCharacter {
  Positions volume_rest_positions;  ///< (n,3) the volume's vertices at rest, object space
  IndexTable volume_bones;          ///< (n,k)
  Values volume_weights;            ///< (n,k)
  Tets tets;                        ///< (m,4)
  Embedding embedding;              ///< of the surface's v vertices in the tets
  IndexTable surface_bones;         ///< (v,j)
  Values surface_weights;           ///< (v,j)
  Matrices4 bone_rest_matrices;     ///< (b,16) or no rows
  Skinning skinning = Skinning::linear;
  double minimum_stretch = 0.05;  ///< of inverse skinning
};

/// One frame of the rig.
struct RigPose {
  Matrices4 bone_matrices;   ///< (b,16) object space at rest to object space posed
  Eigen::Matrix4d armature;  ///< armature's space to object space
  Eigen::Matrix4d world;     ///< object space to the world, m
};

/// Result of one frame.
struct MotionFrame {
  Positions offsets;                  ///< (v,3) to add to the surface's rest positions, object space
  Positions displacements;            ///< (v,3) the secondary motion, in the world, m
  double largest_displacement = 0.0;  ///< m
  double largest_residual = 0.0;      ///< largest part of a displacement that no bounded offset shows, m
};

/// Drives a solver with the poses of a rig.
class RiggedMotion {
 public:
  /// @param solver for the volume's vertices in the world; must outlive this
  /// @param threads that `begin` works with; 0: as many as there are. Where frames are short, one leaves the others to the caller
  /// @throws InvalidInput on arrays that do not fit each other
  RiggedMotion(RiggedCharacter character, Solver& solver, int threads = 1);
  ~RiggedMotion();
  RiggedMotion(const RiggedMotion&) = delete;
  RiggedMotion& operator=(const RiggedMotion&) = delete;

  /// @brief Starts over in a pose, without secondary motion.
  /// @throws InvalidInput on a pose that does not fit or is not finite, or where a frame is under way
  void reset(const RigPose& pose);

  /// @brief Takes one frame.
  /// @param next the pose after, where it is known (see Solver::step)
  /// @throws InvalidInput as `reset`, and where results are no longer finite
  MotionFrame step(const RigPose& pose, const RigPose* next = nullptr);

  /// @brief Starts the same step on a thread of its own, after those that are under way there; `finish` waits for the oldest one.
  ///
  /// While any is under way, the solver is not the caller's to use.
  /// @param offsets (v,3), row by row, takes the offsets rounded to single precision in place of the frame's arrays, which are then
  ///   empty; it must outlive the frame. Null: nothing is rounded
  void begin(const RigPose& pose, std::unique_ptr<RigPose> next, float* offsets = nullptr);

  /// @brief Waits for the oldest frame under way, so long at most, and works on what there is meanwhile.
  /// @param seconds 0 or more
  /// @return whether `finish` would no longer wait
  bool wait(double seconds);

  /// @brief Waits for the oldest frame under way, and works on what there is meanwhile.
  /// @return what `step` returns, bit for bit
  /// @throws what `step` throws, and InvalidInput where none was begun or an offset is more than single precision holds. Those that
  ///   were begun later are then dropped
  MotionFrame finish();

  /// @brief Drops all frames under way, as soon as what has been started of them ends.
  void abandon();

  /// @return (n,3) where the rig alone puts the volume's vertices, in the world, m
  Positions reference(const RigPose& pose) const;

 private:
  class Worker;

  void require_idle() const;
  /// The solver's half of a frame: (n,4) displacements of the volume's vertices, in the world, m; the fourth number is 0.
  Weights4 solve(const RigPose& pose, const RigPose* next);
  /// The surface's half; `rounded` as in `begin`. Safe on several threads at once.
  MotionFrame show(const RigPose& pose, const Weights4& moved, float* rounded) const;

  RiggedCharacter character_;
  Tets corners_;  // (v,4) of the tets that carry the surface's vertices
  Solver& solver_;
  int threads_;
  RigPose ahead_pose_;
  Positions ahead_reference_;  // of ahead_pose_, no rows: none
  std::unique_ptr<Worker> worker_;
};

}  // namespace followthrough
