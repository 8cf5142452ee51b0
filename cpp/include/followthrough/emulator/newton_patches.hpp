// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// What the guides of a frame see (patch_newton.hpp): the backward Euler problem at an estimate of u(t+1), a truncated Newton
/// direction, and vectors and numbers of each free vertex. Training drives it a pass at a time; PatchNewton does the same in one
/// go.
///
/// Lengths are in edges L, times in frames h, masses in rho L^3 with rho the mean density, so that a tet's modulus is
/// s = E h^2 / (rho L^2). The elastic energy is material.hpp's: St. Venant-Kirchhoff, compression resistance, stretches clamped at
/// 0.1; M(z - y) + f(z) + k(z - x(t+1)) is the gradient at z, y = 2 u(t) - u(t-1), with the consistent mass matrix and the springs
/// that pull vertices to the reference, if any (guides do not know of these). The tangent is made convex
/// (Irving et al. 2004): no stress term where the stress is not positive definite, none of the pressure's own.
///
/// The estimate starts at y on free vertices, and at x(t+1) on constrained ones. A direction is a few iterations of conjugate
/// gradients on the tangent, preconditioned by its 3x3 diagonal blocks and, from 768 free vertices on, by a coarse system of
/// vertices that move as one.
///
/// Vectors that the guide of the start is told, in this order:
///   w  [x(t+1) - x(t)] - [u(t) - u(t-1)]            r  x(t+1) - 2 x(t) + x(t-1)
///   a  u(t) - 2 u(t-1) + u(t-2)                      j  u(t) - 3 u(t-1) + 3 u(t-2) - u(t-3)
///   s  u(t) - x(t)                                   q  x(t) - 2 x(t-1) + x(t-2)
///   and of w, a, s the mean over the neighbours minus the vertex's own
/// and that of a pass:
///   g  the direction                                 l  the preconditioned residual that is left
///   p  the first preconditioned residual             m  the last pass's step
///   and of g, l the mean over the neighbours minus the vertex's own
/// Constrained neighbours have w = x(t+1) - y and g = l = 0. Numbers: log(sum of the vectors' squares) / 8 + 0.75, the logarithm
/// between -24 and 6; in a pass half of log(trace(D) / 3 / m), D being the tangent's diagonal block and m the lumped mass; half of
/// log(s) at the vertex and 1 / (1 + n), n tets being between it and the nearest constrained vertex, 20 at most (at the start in
/// the other order); number of neighbours / 14 - 1.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "followthrough/emulator/emulator.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

/// The volume, and its material.
struct NewtonBody : EmulatedBody {
  double poisson_ratio = 0.45;          ///< more than -1, less than 0.5
  double compression_resistance = 1e5;  ///< relative to Young's modulus; not negative
  Vector pin_stiffness;                 ///< (n,) N/m of springs to the reference, not negative; empty: none
};

/// Positions that a frame starts from, m, each (n,3).
struct NewtonHistory {
  std::array<ConstPositions, 4> dynamic;    ///< u(t), u(t-1), u(t-2), u(t-3)
  std::array<ConstPositions, 4> reference;  ///< x(t+1), x(t), x(t-1), x(t-2)
};

/// Of free vertices, f of them, in the order of NewtonPatches::free_vertices.
struct PatchFeatures {
  using Rows = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Rows vectors;  ///< (f, 3 v), v of them one after the other
  Rows scalars;  ///< (f, k)
};

/// How many vectors and numbers a guide is told.
struct GuideSize {
  int vectors, scalars;
};
GuideSize start_guide_size();
GuideSize pass_guide_size();

class NewtonPatches {
 public:
  using Steps = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

  /// @throws InvalidInput as Emulator, and on constants out of range, or a tet without volume
  explicit NewtonPatches(const NewtonBody& body);
  ~NewtonPatches();
  NewtonPatches(NewtonPatches&&) noexcept;
  NewtonPatches& operator=(NewtonPatches&&) noexcept;

  Eigen::Index vertex_count() const;
  double edge_length() const;
  /// (n,) dimensionless stiffness E h^2 / (rho L^2) with each vertex's own density.
  const Vector& stiffness() const;
  /// (f,) vertices, in the order of everything that follows.
  const std::vector<Index>& free_vertices() const;
  /// (f+1,) where a free vertex's edges start.
  const std::vector<Index>& edge_starts() const;
  /// (edges,) the vertex at an edge's other end.
  const std::vector<Index>& neighbours() const;

  /// @brief Starts a frame.
  /// @throws InvalidInput on wrong shapes or numbers that are not finite
  void begin(const NewtonHistory& history);
  /// What the guide of the start is told.
  /// @throws InvalidInput before begin
  PatchFeatures start_features();
  /// @brief Gradient, tangent and direction at the estimate. A step that made the energy worse is taken back first
  /// (patch_newton.hpp).
  /// @param iterations of the conjugate gradients, at most (NewtonPass); they stop at 0.01 of the first residual, at 0.003
  /// after a step that left more than half of it where there is no coarse system
  /// @return the root mean square, over free components, of the first preconditioned residual, in edges; 0 where no part of the
  ///   direction brought the energy down either
  double evaluate(int iterations);
  /// What a pass's guide is told.
  /// @throws InvalidInput before evaluate
  PatchFeatures features();
  /// (f,3) the direction, edges.
  Steps direction() const;
  /// @brief Moves the free vertices of the estimate. After evaluate, the step is the next pass's m.
  /// @param step (f,3) edges
  /// @param last the frame's last pass makes it
  void move(const Steps& step, bool last = false);
  /// @brief After the last pass's step, which is taken back where it made the energy worse: free flesh goes to the reference where
  /// that has less, each part that constrained vertices part from the rest for itself.
  /// @return whether any went, and passes begin again from there
  /// @throws InvalidInput before evaluate
  bool end_passes();
  /// (n,3) the estimate, m.
  Positions estimate() const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
