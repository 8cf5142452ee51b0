// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dynamics by a patch network [DE]: every free vertex is taken one frame further from its own last three frames, the reference and
/// its neighbours in the tets; a constrained vertex takes the reference.
///
/// The network is evaluated exactly, but not naively. The force perceptron's first layer is linear, so each vertex's share in it is
/// computed once and not once an edge; its last layer is linear too and commutes with the sum over the neighbours, and folds into
/// the displacement perceptron's first layer, as the inertia's does. Everything that depends on where the character is in the world
/// is a difference of nearby vertices, taken in double precision, so that the result does not get coarse far from the origin.
#pragma once

#include <memory>

#include "followthrough/emulator/patch_network.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

/// The volume that an Emulator moves.
struct EmulatedBody {
  Positions rest_positions;  ///< (n,3) m
  Tets tets;                 ///< (m,4); every free vertex is in one
  Mask constrained;          ///< (n,) vertices that take the reference
  Vector youngs_modulus;     ///< (n,) Pa
  Vector density;            ///< (n,) kg/m3; a tet has the mean of its vertices'
  double dt = 0;             ///< s a frame
  double edge_length = 0;    ///< m: edge of the cubes that the tets fill; 0: that of cubes of six tets with the median tet's volume
  Eigen::Vector3d gravity = Eigen::Vector3d::Zero();  ///< m/s2, see Emulator
};

/// A network that has never felt gravity moves bodies in it all the same: what is seen from a frame of reference that falls freely
/// has no weight. So positions enter as y(t + k) = x(t + k) - (k h)^2 g / 2, the history, the reference and the neighbours' alike,
/// and the prediction is carried back. Backward Euler's equation is met in the one frame exactly where it is in the other.
class Emulator final : public Solver {
 public:
  /// @throws InvalidInput on wrong shapes, constants that are not positive, a free vertex without mass, a precision that this
  ///   machine does not have, or as require_network
  Emulator(const EmulatedBody& body, const PatchNetwork& network, const NetworkUnits& units = {},
           Precision precision = Precision::float32);
  ~Emulator() override;
  Emulator(Emulator&&) noexcept;
  Emulator& operator=(Emulator&&) noexcept;

  Eigen::Index vertex_count() const override;
  Eigen::Index free_vertex_count() const;
  /// Neighbours in the rings of all free vertices, together.
  Eigen::Index edge_count() const;
  /// Multiply-adds of one step that remain after the exact savings.
  double multiply_adds() const;
  /// m: the scene's L.
  double edge_length() const;
  /// (n,) dimensionless stiffness E h^2 / (rho L^2) at the vertices.
  const Vector& stiffness() const;

  void reset(ConstPositions reference) override;
  /// @param next_reference not used
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  /// Arrays: positions of the last three frames, the newest first, then the reference of the last two. Counters: frames since the
  /// reset.
  SolverState state() const override;
  std::size_t frames_in_state() const override { return 3; }
  void restore(const SolverState& state) override;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
