// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The backward Euler problem of a frame, at an estimate: arrays for the kernels, and what runs them. newton_patches.hpp says what
/// is computed.
///
/// Rows are free vertices along a curve through the volume, then the constrained ones next to them.
#pragma once

#include <cstdint>
#include <string_view>
#include <vector>

#include "emulator/newton_kernel.hpp"
#include "emulator/packed_layers.hpp"
#include "followthrough/emulator/newton_patches.hpp"

namespace followthrough {

/// Where a record's vectors are.
enum RecordColumn : std::int32_t {
  kDirection = 0,
  kFirst = 3,
  kLeft = 6,
  kMotion = 9,
  kSecondary = 12,
  kAcceleration = 15,
  kReferenceAcceleration = 18,
  kTail = 21
};
inline constexpr std::int32_t kRecordSize = 32;

/// @return where each letter's channel starts in a record
std::vector<std::int32_t> channel_columns(std::string_view channels);

struct NewtonProblem {
  explicit NewtonProblem(const NewtonBody& body);

  void begin(const NewtonHistory& history, double beta);
  /// @return root mean square of the first preconditioned residual
  double assemble();
  void solve(int iterations);
  /// Rotations and mean gradients, at the estimate.
  void find_frames();
  /// Brings the records up to date, and what depends on the chosen channels. Sets the frame's channels.
  void describe(const std::vector<std::int32_t>& columns);
  /// @param step (f,3); becomes w
  void move(const float* step);
  void move_along_direction();
  /// Back to the estimate of `save`; the direction of then is what it moves along.
  void save();
  void go_back_and_move_along_direction();
  bool finite() const;
  void start_over();
  /// Positions of all vertices, m.
  void write_estimate(Positions& out) const;

  Eigen::Index count;
  double edge_length, inverse_length;
  Vector stiffness;
  std::int32_t free_count, row_count, padded, groups;
  std::vector<Index> vertices;       // of the rows
  std::vector<Index> free_vertices;  // the first of them
  std::vector<Index> edge_starts, edge_rows, edge_vertices;
  std::vector<Index> unused;  // constrained vertices that are no row's

  // Tets.
  std::int32_t tet_groups;
  std::vector<std::int32_t> corners, tet_starts, tet_blocks, slot_starts, slot_columns, share_starts, share_blocks, border_starts,
      border_columns;
  std::vector<std::uint32_t> slot_turned;
  AlignedFloats gradients, materials, shares, gradient_shares, slot_masses, border_masses, masses, offsets, blocks, diagonal,
      inverse, residual, preconditioned, directions, product, solution, first, rotations, mean_gradients, records, rest_edges,
      sizes, inverse_sizes, own, steps, saved_solution;
  std::vector<float> lumped_masses, half_log_stiffness;
  std::vector<double> positions, start, inertial, saved, last, squares;  // z, its first value, y, z before a step, u(t); (rows, 3)
  std::vector<LaneSums> sums;
  Positions now, target;      // u(t), x(t+1), m
  Eigen::RowVector3d origin;  // of the records' z, in edges
  NewtonTets tet_frame{};
  NewtonRows row_frame{};
  NewtonPatchFrame patch_frame{};
  double residual_square = 0;  // r . D^-1 r at the start of the conjugate gradients
  bool wants_frames = true;    // whether a frame's first evaluation prepares them
  bool began = false, evaluated = false, frames_found = false;

 private:
  void arrange(const NewtonBody& body);
  double sum(int which) const;
  void set_step(std::int32_t row, const float* step);
};

}  // namespace followthrough
