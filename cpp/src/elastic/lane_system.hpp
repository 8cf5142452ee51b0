// SPDX-License-Identifier: GPL-3.0-or-later
// A Newton system in single precision, 16 rows at a time: assembled straight from the elements' stiffness and solved by conjugate
// gradients with the diagonal blocks. The same bits for any number of threads and every instruction set.
#pragma once

#include <memory>
#include <new>
#include <vector>

#include "elastic/conjugate_gradients.hpp"
#include "elastic/lane_rows.hpp"

namespace followthrough {

class LaneSystem {
 public:
  /// @param constant what is added to the stiffness: multiples of the identity (mass, pins). Its pattern is the system's
  /// @param tets of the pattern
  LaneSystem(const BlockMatrix& constant, std::size_t tets);

  /// What the stiffness must be multiplied by, so that numbers stay near 1 whatever the units: one over the mean diagonal.
  double unit() const { return unit_; }
  /// @param stiffness ElasticBody::element_stiffness, times unit()
  /// @return false where a diagonal block is not positive definite, and neither is the matrix
  bool assemble(const std::vector<float>& stiffness);
  /// @return mean ratio of the diagonal to the constant's: about the condition number
  double stiffness_ratio() const;
  /// As solve of BlockMatrix, with the last assembled matrix.
  LinearReport solve(const Vector& b, double tolerance, int most_iterations, Vector& x);

  std::size_t slot_count() const { return columns_.size(); }

 private:
  LaneRows rows() const;
  LaneVectors vectors();
  template <typename Work>
  void for_blocks(const Work& work) const;
  template <typename Work>
  void summed(const Work& work, double (&sums)[2]) const;

  Eigen::Index row_count_;
  std::int32_t padded_, groups_;
  double unit_;
  std::vector<std::int32_t> slot_starts_, columns_, share_starts_, share_blocks_;
  std::vector<float> masses_, blocks_, inverse_, vectors_;
};

}  // namespace followthrough
