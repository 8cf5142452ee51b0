// SPDX-License-Identifier: GPL-3.0-or-later
// A Newton system in single precision, 16 rows at a time: assembled straight from the elements' stiffness and solved by conjugate
// gradients with the diagonal blocks and, beside them, a coarse system in which 64 rows that follow each other move as one. The
// same bits for any number of threads and every instruction set.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "elastic/conjugate_gradients.hpp"
#include "elastic/lane_rows.hpp"
#include "elastic/sparse_cholesky.hpp"

namespace followthrough {

class LaneSystem {
 public:
  /// Rows that are assembled together, so that the stiffness of their elements stays in the caches. Rows that follow each other
  /// should be close together, runs of so many, and of 64, above all.
  static constexpr std::int32_t part_rows = 128;

  /// @param constant what is added to the stiffness: multiples of the identity (mass, pins). Its pattern is the system's
  /// @param tets of the pattern
  LaneSystem(const BlockMatrix& constant, std::size_t tets);

  /// What the stiffness must be multiplied by, so that numbers stay near 1 whatever the units: one over the mean diagonal.
  double unit() const { return unit_; }
  /// Parts that assemble asks for, one after the other in part_tets(): part k has those from part_starts()[k] to [k + 1]. Each
  /// starts at a multiple of single_lanes and repeats its last tet up to the next one. Tets between parts are in each of them.
  const std::vector<std::size_t>& part_starts() const { return part_starts_; }
  const std::vector<Index>& part_tets() const { return part_tets_; }
  /// What puts the stiffness of a part's elements, stiffness_floats each, times unit(), where it is told. From many threads.
  using Fill = std::function<void(std::size_t part, float* to)>;
  /// @param renew_coarse whether the coarse system is made anew as well; it may lag behind as long as it serves
  /// @return false where a diagonal block is not positive definite, and neither is the matrix
  bool assemble(const Fill& fill, bool renew_coarse);
  /// @return mean ratio of the diagonal to the constant's: about the condition number
  double stiffness_ratio() const;
  /// As solve of BlockMatrix, with the last assembled matrix.
  LinearReport solve(const Vector& b, double tolerance, int most_iterations, Vector& x);
  /// @return the preconditioner's inverse times b, in the matrix's own scale: where conjugate gradients go first
  Vector preconditioned(const Vector& b);

  std::size_t slot_count() const { return columns_.size(); }
  /// Whether there is a coarse system: small bodies, and those whose last one was not positive definite, do without.
  bool has_coarse() const { return coarse_ && coarse_->definite; }
  /// Turns the coarse system off.
  void drop_coarse() { coarse_.reset(); }

 private:
  // Of aggregates: each row of the matrix moves as its aggregate does. Interior elements, whose stiffness cancels out, are left out
  // instead of relying on that.
  struct Coarse {
    BlockMatrix matrix;
    SparseCholesky factor;
    std::vector<double> masses;  // of the matrix's blocks, times the identity
    std::vector<float> sums;     // two lists of blocks: between others, and of rows beside something constrained
    std::vector<float> restricted, corrections;
    Vector right, left;
    bool definite = false;
  };

  void find_parts(const BlockMatrix& constant, std::size_t tets, const std::vector<std::int32_t>& places);
  void find_coarse(const BlockMatrix& constant, std::size_t tets, const std::vector<std::int32_t>& places);
  void factor_coarse();
  double correct(double slope);
  void start(const Vector& b, double size, double (&sums)[2]);
  LaneRows rows() const;
  LaneVectors vectors();
  template <typename Work>
  void for_blocks(const Work& work) const;
  template <typename Work>
  void summed(const Work& work, double (&sums)[2]) const;

  Eigen::Index row_count_;
  std::int32_t padded_, groups_;
  double unit_;
  std::vector<std::int32_t> slot_starts_, columns_, share_starts_, share_blocks_, coarse_places_;
  std::vector<std::size_t> part_starts_;
  std::vector<Index> part_tets_;
  std::int32_t part_groups_;
  std::size_t largest_part_ = 0;
  std::vector<float> masses_, blocks_, inverse_, vectors_;
  std::vector<std::vector<float>> workspaces_;  // a part's stiffness, for each thread
  std::optional<Coarse> coarse_;
};

}  // namespace followthrough
