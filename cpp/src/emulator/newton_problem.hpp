// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The backward Euler problem of a frame, at an estimate: arrays for the kernels, and what runs them. newton_patches.hpp says what
/// is computed.
///
/// Rows are free vertices along a curve through the volume, then the constrained ones next to them.
#pragma once

#include <cstdint>
#include <vector>

#include "emulator/newton_kernel.hpp"
#include "emulator/packed_layers.hpp"
#include "followthrough/emulator/newton_patches.hpp"

namespace followthrough {

/// Vectors that a guide is told, in its order (newton_patches.hpp): w a s r j q and three means; g p l m and two means.
inline constexpr std::int32_t kStartVectors = 9, kPassVectors = 6;
/// And other numbers.
inline constexpr std::int32_t kStartScalars = 4, kPassScalars = 5;

struct NewtonProblem {
  explicit NewtonProblem(const NewtonBody& body);

  /// The estimate starts on y.
  void begin(const NewtonHistory& history);
  /// Evaluates the estimate: equations, residual, energy.
  /// @return root mean square of the first preconditioned residual
  double assemble();
  /// Finds the direction; `slope` is that of the energy along it.
  void solve(int iterations);
  /// Brings `inputs` up to date for the guide of the start, or of a pass that has been solved.
  void describe_start();
  void describe_pass();
  /// @param step (3,padded); becomes m where it is a pass's
  void move(const float* step, bool of_pass);
  void move_along_direction();
  /// Keeps the estimate and the direction.
  void save();
  /// Goes back to the estimate of `save`, and from there a share of the direction of then.
  void go_back_and_move(double share);
  /// Slope at the estimate of the energy along the direction of `save`.
  double slope_along_saved() const;
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
  AlignedFloats gradients, materials, shares, energies, slot_masses, border_masses, masses, offsets, blocks, diagonal, inverse, residual,
      preconditioned, directions, product, solution, first, saved_solution;
  // What guides are told, and what they say. Each vector is (3,padded), each number (padded,).
  AlignedFloats history, means, records, motion, log_squares, log_diagonals, inverse_squares, steps;
  std::vector<const float*> start_vectors, pass_vectors, start_scalars, pass_scalars;
  GuideInputs inputs{};
  std::vector<float> lumped_masses, half_log_stiffness, nearness, fullness;
  std::vector<double> positions, start, inertial, saved, last;  // z, its first value, y, z before a step, u(t); (rows, 3)
  std::vector<LaneSums> sums;
  Positions now, target;                                 // u(t), x(t+1), m
  Eigen::RowVector3d fall = Eigen::RowVector3d::Zero();  // of a free body in a frame, edges
  NewtonTets tet_frame{};
  NewtonRows row_frame{};
  double residual_square = 0;  // r . D^-1 r at the start of the conjugate gradients
  double energy = 0, slope = 0;
  bool began = false, evaluated = false;

 private:
  void arrange(const NewtonBody& body);
  double sum(int which) const;
  void find_nearness(const NewtonBody& body);
  void find_means();
  void describe(const std::vector<const float*>& vectors, const std::vector<const float*>& scalars);
};

}  // namespace followthrough
