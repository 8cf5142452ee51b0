// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The backward Euler problem of a frame, at an estimate: arrays for the kernels, and what runs them. newton_patches.hpp says what
/// is computed.
///
/// Rows are free vertices, compact in runs (compact_order.hpp), then the constrained ones next to them.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "emulator/coarse_rows.hpp"
#include "emulator/newton_kernel.hpp"
#include "emulator/packed_layers.hpp"
#include "followthrough/emulator/newton_patches.hpp"
#include "team_barrier.hpp"

namespace followthrough {

/// Vectors that a guide is told, in its order (newton_patches.hpp): w a s r j q and three means; g p l m and two means.
inline constexpr std::int32_t kStartVectors = 9, kPassVectors = 6;
/// And other numbers.
inline constexpr std::int32_t kStartScalars = 4, kPassScalars = 5;

/// A tet with its numbers, in edges, frames and mean densities.
struct RowTet {
  std::array<std::int32_t, 4> rows{};  ///< ascending
  Eigen::Matrix3d gradients;           ///< inverse of the rest edges
  double volume = 0, mass = 0, mu = 0, lambda = 0, resistance = 0;
};

/// Of the equations at an estimate (newton_tets.kernel.cpp). The exact one leads home fastest from nearby, but may be indefinite.
enum class Tangent { convex, exact };

struct NewtonProblem {
  /// Groups of 16 rows in a part: fixed, so that sums do not depend on threads.
  static constexpr std::int32_t part_groups = 16;
  /// Share of the preconditioned residual that conjugate gradients usually leave.
  static constexpr double usual_tolerance = 0.01;

  /// (newton_arrangement.cpp)
  explicit NewtonProblem(const NewtonBody& body);

  /// How many threads to share work among.
  int threads(double nanoseconds_a_row) const;
  /// The estimate starts on y.
  void begin(const NewtonHistory& history);
  /// Evaluates the estimate: equations, residual, energy. The exact tangent gives way to the convex one where a diagonal block of
  /// it is not positive definite.
  /// @return root mean square of the first preconditioned residual
  double assemble(Tangent tangent);
  /// Finds the direction by so many iterations at most, or fewer that leave so much of the preconditioned residual; `slope` is that
  /// of the energy along it. It is the convex tangent's where the exact one turns out not to be positive definite.
  void solve(int most, double tolerance = usual_tolerance);
  /// Root mean square of the direction that has just been found, in edges.
  double direction_length() const;
  /// What the guide of the start, or of a pass that has been solved, is told: brought up to date by `record` of every row, where it
  /// is a pass's, and then `describe` of every group, in whatever order. `describe_start` and `describe_pass` do it all.
  GuideInputs start_inputs() const;
  GuideInputs pass_inputs() const;
  void record(std::int32_t row);
  void describe(const GuideInputs& inputs, std::int32_t group);
  GuideInputs describe_start();
  GuideInputs describe_pass();
  /// @param step (3,padded); becomes m where it is a pass's
  void move(const float* step, bool of_pass);
  /// Its two parts: every group on its own, then what is left to do.
  void move_group(const float* step, std::int32_t group);
  void have_moved(const float* step, bool of_pass);
  void move_along_direction();
  /// Keeps the estimate and the direction.
  void save();
  /// Goes back to the estimate of `save`, and from there a share of the direction of then.
  void go_back_and_move(double share);
  /// Slope at the estimate, which has been evaluated, of the energy along the direction of `save`.
  double slope_along_saved() const;
  /// Begins again with the free vertices at positions of all, m.
  void go_to(ConstPositions there);
  /// Begins again with the free vertices of some islands at x(t+1). An island is free flesh that constrained vertices part from the
  /// rest, so that neither knows of the other within a frame.
  /// @param chosen (island_count,)
  void go_to_reference(const std::vector<bool>& chosen);
  /// (island_count,) energies at the estimate, which has been evaluated; with lumped masses where there are several.
  std::vector<double> island_energies() const;
  /// (island_count,) the energy that inertia has at x(t+1), with lumped masses.
  std::vector<double> island_inertia_at_reference() const;
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
  std::vector<std::size_t> islands;  // of the free rows
  std::size_t island_count = 0;
  std::vector<Index> unused;  // constrained vertices that are no row's

  // What the kernels read and write (newton_kernel.hpp).
  std::int32_t parts;
  std::vector<std::int32_t> corners, places, part_tets, part_sums, halo_starts, halo_places, row_places, slot_starts, slot_columns,
      slot_places, border_starts, border_columns;
  std::vector<std::int16_t> rounded_blocks;
  AlignedFloats gradients, materials, energies, sums, slot_masses, slot_turned, border_masses, masses, offsets, scales, traces,
      roots, blocks, diagonal, inverse, residual, preconditioned, directions, product, solution, first, saved_solution;
  AlignedFloats pins, ways;  // none where nothing is pinned softly
  // What guides are told, and what they say. Each vector is (3,padded), each number (padded,).
  AlignedFloats history, means, records, motion, log_squares, log_diagonals, inverse_squares, steps;
  std::vector<const float*> start_vectors, pass_vectors, start_scalars, pass_scalars;
  std::vector<float> lumped_masses, half_log_stiffness, nearness, fullness;
  std::vector<double> positions, start, inertial, saved, last;  // z, its first value, y, z before a step, u(t); (rows, 3)
  std::vector<LaneSums> lane_sums;
  std::vector<double> part_numbers;
  std::optional<CoarseRows> coarse;  // of large bodies
  TeamBarrier barrier;               // of the threads that share a pass
  int frames_alone = 0, next_frames_alone = 0;
  Positions now, target;                                 // u(t), x(t+1), m
  Eigen::RowVector3d fall = Eigen::RowVector3d::Zero();  // of a free body in a frame, edges
  NewtonTets tet_frame{};
  NewtonRows row_frame{};
  double residual_square = 0;  // r . D^-1 r at the start of the conjugate gradients
  double energy = 0, slope = 0;
  bool began = false, evaluated = false;
  int iterations = 0;  // that the last direction took

 private:
  void arrange(const NewtonBody& body);
  std::vector<double> arrange_edges(const std::vector<RowTet>& tets);
  void arrange_parts(const std::vector<RowTet>& tets);
  void arrange_slots(const std::vector<double>& neighbour_masses);
  void arrange_coarse(const std::vector<double>& neighbour_masses);
  void fill_tets(const std::vector<RowTet>& slots);
  struct FreeEdges {
    Index begin, higher, end;
  };
  FreeEdges free_edges(std::int32_t row) const;
  std::int32_t sum_place(std::int32_t row, std::int32_t other) const;
  std::int32_t offset_row(std::int32_t row) const;
  Eigen::RowVector3d in_edges(ConstPositions there, std::int32_t row) const;
  void put(std::int32_t row, const Eigen::RowVector3d& there);
  std::int32_t last_group(std::int32_t part) const;
  double sum(int which) const;
  double assemble_as(Tangent tangent);
  bool indefinite() const;
  bool solve_as_assembled(int most, double tolerance);
  void make_coarse(std::int32_t first_part, std::int32_t last_part);
  double correct(std::int32_t first_part, std::int32_t last_part);
  void find_nearness(const NewtonBody& body);
  void find_islands();
  double lumped_inertia(std::int32_t row, const Eigen::RowVector3d& there) const;
  GuideInputs inputs_of(const std::vector<const float*>& vectors, const std::vector<const float*>& scalars) const;
};

}  // namespace followthrough
