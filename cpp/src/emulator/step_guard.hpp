// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Watches what the steps of a frame's passes do to the energy (patch_newton.hpp). Guides are mostly right, and nothing says that
/// they always are.
#pragma once

#include <optional>
#include <vector>

#include "emulator/newton_problem.hpp"

namespace followthrough {

class StepGuard {
 public:
  explicit StepGuard(NewtonProblem& problem) : problem_(problem) {}

  /// Of a frame: nothing has been taken yet.
  void begin() {
    taken_.reset();
    rate_ = 0;
    slow_ = eager_ = false;
    guided_ = directions_exact_ = true;
    steps_ = 0;
  }
  /// Of a frame that begins again as the simulation does: from now on as many iterations as after a slow step, and steps along the
  /// direction go farther wherever the energy still falls there, as the simulation's do.
  void begin_again() {
    taken_.reset();
    rate_ = 0;
    slow_ = eager_ = true;
  }
  /// @brief Evaluates the estimate. Where the step that led to it makes the energy worse, the direction is taken instead, or the
  /// part of it that brings the energy down, or, where compression makes the energy a cubic, more than all of it.
  /// @param tangent of the estimate
  /// @return root mean square of the first preconditioned residual; 0 where nothing brought the energy down, so that nothing was
  /// moved
  double evaluate(Tangent tangent = Tangent::convex);
  /// Of the conjugate gradients, where a pass is to have so many: twice as many once a step of the frame has left more than half of
  /// the residual. Stiff bodies and thin limbs bend in ways that reach far, and those iterations have not come to.
  int iterations(int of_pass) const { return slow_ ? 2 * of_pass : of_pass; }
  /// The share of the preconditioned residual that they may leave: less after such a step, for the same reason. A coarse system
  /// counts what reaches far as well.
  double tolerance() const { return slow_ && !problem_.coarse ? slow_tolerance : NewtonProblem::usual_tolerance; }
  /// A direction has been found.
  void has_solved(int of_pass) { directions_exact_ = directions_exact_ && (problem_.coarse || problem_.iterations < of_pass); }
  /// Whether a guide may make the step of the direction that has been found. Where all of the frame's directions are exact, guides
  /// make the first two steps, unless one after the first has left more than half of the residual: from there the direction
  /// itself leads home faster. Elsewhere they know better than it how far to go.
  bool guided() const { return !directions_exact_ || (guided_ && steps_ < most_guided); }
  /// Of the step that has been taken: the exact one where guides have done what they can and little was left before it already.
  /// @param expected_error before it, edges
  Tangent tangent(double expected_error) const {
    return directions_exact_ && steps_ + 1 >= most_guided && expected_error < near_end ? Tangent::exact : Tangent::convex;
  }
  /// @brief What the estimate is off by, in edges, if passes go on as the last one did: the sum of what they would do.
  /// @param reach of the last pass's direction, over the residual that it was found for
  double expected_error(double reach) const;
  /// @brief Whether the direction that has been found ends the frame so surely that nobody needs to look: it leaves no larger share
  /// of what is left than the step before it did, and that is little enough, and no island is to be asked whether it had better go
  /// to the reference.
  /// @param enough of an error, edges
  bool ends_frame(double reach, double enough) const;
  /// The estimate, evaluated and solved, is about to be moved: by a guide's step or along the direction.
  /// @param last of the frame's passes: nothing smooths the ripples that it leaves
  void before_step(bool guided, bool last);
  /// Evaluates the last step, if there is one that has not been.
  void end() {
    if (taken_) evaluate();
  }
  /// @brief After `end`: islands of free flesh go to the reference where that has less energy, inertia included.
  ///
  /// Flesh that was torn and twisted may have found another equilibrium. Mostly inertia alone has more energy there.
  /// @return whether any went
  bool go_to_better_reference();

 private:
  /// A pass's step, until it is known what it did to the energy.
  struct TakenStep {
    double energy, left, slope;  ///< where it began; along the whole direction
    double share;                ///< of the direction; 0: a guide's
    bool last;

    bool good(double energy_there, double left_there) const;
    /// Where the parabola through what is known of a share is least.
    double shorter_share(double energy_there) const;
  };

  static constexpr int most_guided = 2;
  static constexpr double near_end = 0.02, slow_tolerance = 0.003;

  double evaluate_step();
  std::vector<bool> better_off_at_reference(const std::vector<double>& energies) const;
  double retake(double share);
  double lengthen(double left);

  NewtonProblem& problem_;
  std::optional<TakenStep> taken_;  // not evaluated yet
  double left_ = 0, rate_ = 0;      // of the last step: the residual that it left, and over that before it
  bool slow_ = false;               // a step of the frame left much
  bool directions_exact_ = true;    // conjugate gradients with a coarse system, or that ended early
  bool guided_ = true;              // and none after the first did
  int steps_ = 0;                   // of the frame, evaluated
  Tangent tangent_ = Tangent::convex;
  bool eager_ = false;  // whole steps may go farther
};

}  // namespace followthrough
