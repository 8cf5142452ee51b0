// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The residual of a backward Euler step, evaluated again and again: for solvers and networks that correct an estimate by how far
/// it is from solving the step.
#pragma once

#include <vector>

#include "followthrough/elastic/elastic_body.hpp"

namespace followthrough {

/// (n,3), kg m: as many as positions, in single precision.
using SingleForces = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// M (x - y) + dt^2 f(x) of invertible StVK for positions x and inertial positions y = 2 u(t) - u(t-1): what ImplicitEuler brings
/// to zero at the free vertices. The same bits for any number of threads; nothing is allocated after construction.
class BackwardEulerForce {
 public:
  enum class Precision {
    kDouble,  ///< to 1e-15 of the largest elastic force
    kSingle   ///< to some 1e-7 of it; positions are still told apart in double precision, wherever the body is
  };

  /// @param body copied
  /// @param dt s a frame, more than 0
  /// @throws InvalidInput where dt is not such a number
  BackwardEulerForce(const ElasticBody& body, double dt, Precision precision = Precision::kDouble);
  ~BackwardEulerForce();
  BackwardEulerForce(const BackwardEulerForce&) = delete;
  BackwardEulerForce& operator=(const BackwardEulerForce&) = delete;

  Eigen::Index vertex_count() const { return body_.vertex_count(); }

  /// @param positions (n,3) m, finite
  /// @param inertial (n,3) m: where the vertices would be without any force
  /// @param force (n,3) kg m, overwritten; divided by dt^2 it is in N
  /// @throws InvalidInput on a wrong shape
  void evaluate(ConstPositions positions, ConstPositions inertial, Eigen::Ref<Positions> force);
  void evaluate(ConstPositions positions, ConstPositions inertial, Eigen::Ref<SingleForces> force);

 private:
  void evaluate(ConstPositions positions, ConstPositions inertial);
  void add_single_forces();
  template <typename Force>
  void write(Force& force) const;

  ElasticBody body_;
  double square_;  // dt^2
  Precision precision_;
  InvertibleStVK material_;
  PaddedPositions positions_, away_, force_;
  std::vector<float> single_masses_;
  std::vector<Padded<float>> single_away_, single_force_;
};

}  // namespace followthrough
