// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dynamics by truncated Newton steps that small networks guide. A frame is backward Euler's (newton_patches.hpp). A guide makes
/// its first estimate of the last frames; then come a few passes, each a direction by a few iterations of conjugate gradients and a
/// guide that makes the step of it. Passes end as soon as little is left to do. A pass without a guide steps along the direction.
/// So do those after a frame's first two, or after a later one than the first that has left more than half of its residual, as
/// long as conjugate gradients have solved every direction of the frame: in less than the pass's iterations or with the coarse
/// system of large bodies. Near the end these have the exact tangent, unless that is indefinite.
/// A direction that, leaving no larger share than the step before it, would leave little enough ends the frame unseen.
/// Any other step along the direction must bring the energy 1/2 (z - y) M (z - y) + W(z), and that of soft pins, down (Armijo's
/// rule), a guide's must not raise it by more than its slope along the direction or a quarter, the last one's not at all. Else the
/// direction is taken, or as much of it as does, or more where the energy still falls. A frame whose residuals still add up to a
/// fiftieth of an edge after four passes may have several solutions: it begins again where the simulation starts a step
/// (implicit_euler.hpp), with up to 48 passes without guides, to find the one that the simulation finds.
///
/// A guide is a perceptron at every free vertex. It makes the coefficients of a weighted sum of the vectors of newton_patches.hpp,
/// from their products (the signed root of |v_a . v_b| over the sum of the vectors' squares, plus 1e-9 where that is not zero) and
/// a few numbers. So what is moved or turned as a whole moves and turns the same, and what is at rest stays there.
#pragma once

#include <memory>
#include <vector>

#include "followthrough/emulator/newton_patches.hpp"
#include "followthrough/emulator/patch_network.hpp"
#include "followthrough/solver.hpp"

namespace followthrough {

/// A tanh after every layer but the last. v vectors and k numbers make v (v + 1) / 2 + k inputs, and there are v outputs.
using Guide = std::vector<DenseLayer>;

struct NewtonPass {
  int iterations = 0;  ///< of the conjugate gradients, at most; twice as many once a pass of the frame has left more than half of
                       ///< its residual
  Guide guide;         ///< of 6 vectors and 5 numbers; none: the step is the direction
};

struct NewtonSchedule {
  Guide start;                     ///< of 9 vectors and 4 numbers
  std::vector<NewtonPass> passes;  ///< the last one is repeated; none: the first estimate is the frame
  int most_passes = 16;
  double tolerance = 1e-3;    ///< edges: passes end where the root mean square of what they would still do is less, judged by the
                              ///< rate at which residuals fall (before the first, where the residual is), or, in frames whose first
                              ///< step is shorter than a tenth of an edge, as much less
  int extra_passes = 0;       ///< without a guide, after the others: each takes the frame nearer to backward Euler's own answer
  int extra_iterations = 16;  ///< of each of them
};

/// @throws InvalidInput where layers do not fit each other or their inputs, hold a number that is not finite, or a number is out of
///   range; `passes.0.guide.1.weight` and the like name the place
void require_schedule(const NewtonSchedule& schedule);

class PatchNewton final : public Solver {
 public:
  /// Gravity is felt as Emulator has it: positions are those that are seen from a freely falling frame of reference.
  /// @throws InvalidInput as NewtonPatches and require_schedule
  PatchNewton(const NewtonBody& body, const NewtonSchedule& schedule);
  ~PatchNewton() override;
  PatchNewton(PatchNewton&&) noexcept;
  PatchNewton& operator=(PatchNewton&&) noexcept;

  Eigen::Index vertex_count() const override;
  Eigen::Index free_vertex_count() const;
  /// Neighbours of all free vertices, together.
  Eigen::Index edge_count() const;
  /// Multiply-adds of the guides and conjugate gradients of a step with as many passes as `passes` has.
  double multiply_adds() const;
  /// m: the scene's L.
  double edge_length() const;
  /// (n,) dimensionless stiffness E h^2 / (rho L^2) at the vertices.
  const Vector& stiffness() const;

  void reset(ConstPositions reference) override;
  /// @param next_reference not used
  const Positions& step(ConstPositions reference, const Positions* next_reference = nullptr) override;

  std::size_t frames_in_state() const override { return 4; }
  /// u(t) to u(t-3), x(t) to x(t-2); frames since the reset.
  SolverState state() const override;
  void restore(const SolverState& state) override;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace followthrough
