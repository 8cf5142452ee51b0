// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// One vertex's motion in all sequences, as the springs' recursion needs it, and the loss that constants give on it.
#pragma once

#include <span>
#include <vector>

#include "followthrough/springs/spring_coefficients.hpp"
#include "followthrough/springs/spring_fit.hpp"

namespace followthrough {

/// Three axes and one that stays 0, so that registers are full.
using Axes = Eigen::Array4d;

/// The loss and its derivatives with respect to log ks and log kd.
struct LossGradient {
  double loss;
  Eigen::Vector2d gradient;
  Eigen::Matrix2d curvature;  ///< Gauss-Newton's: of the products of first derivatives
};

class VertexMotion {
 public:
  /// What is wanted is the simulated lag from the reference, and all frames count.
  void read(std::span<const SpringTraining> motions, Eigen::Index vertex);
  /// What is wanted becomes so many times what it was.
  void scale_wanted(double factor);

  /// @name Sums over all frames, m^2
  /// @{
  double excitation() const { return excitation_; }  ///< of the reference's acceleration (times dt^2) squared
  double lag() const { return lag_; }                ///< of the simulated distance from the reference squared
  double extent() const { return extent_; }          ///< of the reference's distance from where it begins squared
  double size() const { return size_; }              ///< of the reference's distance from the origin squared
  /// @}
  std::size_t steps() const { return wanted_.size(); }

  /// Leaves frames out of the loss: those of the greatest weight 0. One number a step, 0 or 1.
  std::vector<double>& weights() { return weights_; }
  double weight_of_wanted() const;  ///< sum of squares of what is wanted, weighted

  double loss(double stiffness, double damping) const;
  LossGradient loss_gradient(double stiffness, double damping) const;

  /// The error of one frame's prediction from the two true frames before it, whose sum of squares has no narrow valleys.
  LossGradient one_frame_loss_gradient(double stiffness, double damping) const;

  /// @return squared distance of each step, unweighted
  void squared_errors(double stiffness, double damping, std::vector<double>& errors) const;

 private:
  struct Run {
    std::size_t first, last;  // steps
    double dt;
  };
  std::vector<Run> runs_;
  std::vector<Axes, Eigen::aligned_allocator<Axes>> bend_, turn_, wanted_;  // a step each
  std::vector<double> weights_;
  double excitation_ = 0.0, lag_ = 0.0, extent_ = 0.0, size_ = 0.0;
};

}  // namespace followthrough
