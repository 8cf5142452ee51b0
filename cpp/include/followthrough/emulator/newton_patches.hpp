// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// What a network that corrects Newton steps sees of a frame: the backward Euler problem at an estimate of u(t+1), a truncated
/// Newton direction, and both as numbers of each free vertex and its neighbours in the vertex's own frame. Training drives it a
/// pass at a time; PatchNewton (patch_newton.hpp) does the same in one go.
///
/// Lengths are in edges L, times in frames h, masses in rho L^3 with rho the mean density, so that a tet's modulus is
/// s = E h^2 / (rho L^2). The elastic energy is material.hpp's: St. Venant-Kirchhoff, compression resistance, stretches clamped at
/// 0.1; M(z - y) + f(z) is the gradient at z, y = 2 u(t) - u(t-1), with the consistent mass matrix. The tangent is made convex
/// (Irving et al. 2004): no stress term where the stress is not positive definite, none of the pressure's own.
///
/// The estimate starts at y + beta w on free vertices, w = [x(t+1) - x(t)] - [u(t) - u(t-1)], and at x(t+1) on constrained ones.
/// A direction is a few iterations of conjugate gradients on the tangent, preconditioned by its 3x3 diagonal blocks.
///
/// Channels are vectors of every vertex, each a letter:
///   g  the direction                                    w  w at the first pass, afterwards the last pass's step
///   p  the first preconditioned residual                s  u(t) - x(t)
///   l  the preconditioned residual that is left         a  u(t) - 2 u(t-1) + u(t-2)
///                                                       r  x(t+1) - 2 x(t) + x(t-1)
/// g, p, l, w are zero on constrained vertices. R is the rotation nearest to F, the mean deformation gradient of the tets around a
/// free vertex weighted by volume, both of the first pass. sigma is the root of the mean, over the vertex and its neighbours, of
/// the sum of the channels' squares. What the network is told, c being the number of channels:
///   an edge (3c+8)     R^T v_j / sigma of each channel; R^T (z_j - z_i) - E, within 3; E, the rest edge; 1 where j is constrained;
///                      half d_j
///   a centre (3c+17)   R^T v_i / sigma of each channel; log(sigma) / 4 + 0.75, between -2.25 and 1.5; half d_i; half log(s_i);
///                      2 (sym(R^T F) - 1) as xx yy zz xy xz yz; likewise R^T D R over a third of its trace, minus 1, both within
///                      4; the lumped mass m_i; number of neighbours / 12 - 1
/// where D is the tangent's diagonal block and d = log(trace(D) / 3 / m), 0 on constrained vertices.
#pragma once

#include <memory>
#include <string_view>
#include <vector>

#include "followthrough/emulator/emulator.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

struct NewtonProblem;

/// The volume, and its material.
struct NewtonBody : EmulatedBody {
  double poisson_ratio = 0.45;          ///< more than -1, less than 0.5
  double compression_resistance = 1e5;  ///< relative to Young's modulus; not negative
};

/// Positions that a frame starts from, m, each (n,3).
struct NewtonHistory {
  ConstPositions now, before, before_that;                         ///< u(t), u(t-1), u(t-2)
  ConstPositions reference_before, reference_now, reference_next;  ///< x(t-1), x(t), x(t+1)
};

/// Numbers of free vertices (f of them, in the order of NewtonPatches::free_vertices) and their edges.
struct PatchFeatures {
  using Rows = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Rows edges;             ///< (edges, 3c+8)
  Rows centres;           ///< (f, 3c+17)
  Eigen::VectorXf sizes;  ///< (f,) sigma
  Rows rotations;         ///< (f, 9) R, row by row
};

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
  /// @param beta share of w in the first estimate, 0 to 1
  /// @throws InvalidInput on wrong shapes or numbers that are not finite
  void begin(const NewtonHistory& history, double beta);
  /// @brief Gradient, tangent and direction at the estimate.
  /// @param iterations of the conjugate gradients, at most; they stop at 0.003 of the first residual
  /// @return the root mean square, over free components, of the first preconditioned residual, in edges
  double evaluate(int iterations);
  /// @throws InvalidInput on an unknown channel, or none, or before evaluate
  PatchFeatures features(std::string_view channels);
  /// (f,3) the direction, edges.
  Steps direction() const;
  /// @brief Moves the free vertices of the estimate; the step is the next pass's w.
  /// @param step (f,3) edges
  void move(const Steps& step);
  /// (n,3) the estimate, m.
  Positions estimate() const;

 private:
  std::unique_ptr<NewtonProblem> problem_;
};

/// @throws InvalidInput naming the letter, where there is none or one is no channel or there twice
void require_channels(std::string_view argument, std::string_view channels);

}  // namespace followthrough
