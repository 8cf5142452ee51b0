// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dynamics by truncated Newton steps that a network corrects. A frame is backward Euler's (newton_patches.hpp), solved in a few
/// passes: a direction by a few iterations of conjugate gradients, then, where the pass has a network, the step that it makes of
/// the direction and of what lies around each vertex. A pass without a network steps along the direction. All of it is made of
/// differences, so what is at rest stays there, and what is moved or turned as a whole moves and turns the same.
///
/// The network of a pass, with E the inputs of an edge and C those of a centre: h = tanh(W_e E + W_c C + b), further layers
/// h = tanh(W h + b); an eighth of the sum of h over the neighbours, joined with C, goes through layers of the same kind; the step
/// is sigma R (W_o h + skip v), v being the centre's first channel in its own frame.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "followthrough/emulator/newton_patches.hpp"
#include "followthrough/emulator/patch_network.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

struct NewtonPass {
  int iterations = 0;                ///< of the conjugate gradients, at most
  std::string channels;              ///< newton_patches.hpp; empty: a pass without a network, and nothing below
  std::vector<DenseLayer> edge;      ///< the first one takes 3c+8 numbers and has no bias
  DenseLayer centre;                 ///< 3c+17 numbers to as many as the first of `edge`
  std::vector<DenseLayer> instance;  ///< the first one takes the last of `edge`, then the 3c+17
  DenseLayer out;                    ///< to 3 numbers; no bias
  float skip = 0;

  bool has_network() const { return !channels.empty(); }
};

struct NewtonSchedule {
  std::vector<NewtonPass> passes;
  double beta = 0.5;          ///< where a frame starts (newton_patches.hpp), 0 to 1
  int extra_passes = 0;       ///< without a network, after the others: each takes the frame nearer to backward Euler's own answer
  int extra_iterations = 16;  ///< of each of them
};

/// @throws InvalidInput where layers do not fit each other or the inputs above, hold a number that is not finite, or a number of
/// passes
///   or iterations is out of range; `passes.0.edge.1.weight` and the like name the place
void require_schedule(const NewtonSchedule& schedule);

class PatchNewton final : public Solver {
 public:
  /// @throws InvalidInput as NewtonPatches and require_schedule
  PatchNewton(const NewtonBody& body, const NewtonSchedule& schedule);
  ~PatchNewton() override;
  PatchNewton(PatchNewton&&) noexcept;
  PatchNewton& operator=(PatchNewton&&) noexcept;

  Eigen::Index vertex_count() const override;
  Eigen::Index free_vertex_count() const;
  /// Neighbours of all free vertices, together.
  Eigen::Index edge_count() const;
  /// Multiply-adds of one step's networks and conjugate gradients.
  double multiply_adds() const;
  /// m: the scene's L.
  double edge_length() const;
  /// (n,) dimensionless stiffness E h^2 / (rho L^2) at the vertices.
  const Vector& stiffness() const;

  void reset(ConstPositions reference) override;
  /// @param next_reference not used
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  /// As Emulator's.
  SolverState state() const override;
  void restore(const SolverState& state) override;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
