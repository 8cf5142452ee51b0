// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The one interface of every dynamics method. Live preview, bake, the command line, training data and benchmarks all drive it, so
/// what is previewed is what is baked.
#pragma once

#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// Everything that a solver carries from one frame to the next; copying it back resumes the run bit for bit.
struct SolverState {
  std::vector<Positions> arrays;       ///< solver-specific (n,3) arrays, for example positions and velocities
  std::vector<std::int64_t> counters;  ///< solver-specific integers, for example frames since the reset
};

/// A method that takes the volume's vertices one frame further, given where skinning puts them (the reference).
class Solver {
 public:
  virtual ~Solver() = default;

  /// Number of vertices, n.
  virtual Eigen::Index vertex_count() const = 0;

  /// @brief Starts over, on the reference and moving with it.
  /// @param reference (n,3) reference positions of the first frame, m
  /// @throws InvalidInput on a wrong shape or non-finite numbers; the state is then unchanged
  virtual void reset(ConstPositions reference) = 0;

  /// @brief Takes one frame.
  /// @param reference (n,3) reference positions of the frame to reach, m
  /// @param next_reference (n,3) those of the frame after it, where the caller knows them: a solver that interpolates its target
  ///   smoothly (Springs) needs the slope there and otherwise falls back to the one-sided one. Null: not known.
  /// @return (n,3) dynamic positions, m, valid until the next call
  /// @throws InvalidInput on a wrong shape or non-finite numbers, or before the first reset; the state is then unchanged
  virtual const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) = 0;

  virtual SolverState state() const = 0;

  /// @brief How many of the state's first arrays are positions of the last frames, the newest first, and hold all of its motion:
  ///   whoever moves them moves the solver. 1: the newest alone, and velocities elsewhere.
  virtual std::size_t frames_in_state() const { return 1; }

  /// @throws InvalidInput where the state is not one of this solver and size
  virtual void restore(const SolverState& state) = 0;
};

}  // namespace followthrough
