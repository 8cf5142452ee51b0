// SPDX-License-Identifier: GPL-3.0-or-later
// Laplace's equation on tets: values given at some vertices, smoothest possible ones everywhere else.
#pragma once

#include <memory>

#include "followthrough/types.hpp"

namespace followthrough {

enum class Stencil {
  kLinear,      ///< linear finite elements: linear functions come out exactly; obtuse tets may overshoot what is given
  kNonnegative  ///< the same with couplings of the wrong sign left out: an M-matrix, so results never leave the range of what is
                ///< given
};

/// Factored once, so that each solve is cheap.
class LaplaceSolver {
 public:
  /// @param given (n,) vertices whose values will be given. Vertices that hang together with none of them are treated as given,
  /// too.
  LaplaceSolver(ConstPositions vertices, ConstTets tets, const Mask& given, Stencil stencil);
  ~LaplaceSolver();
  LaplaceSolver(LaplaceSolver&&) noexcept;
  LaplaceSolver& operator=(LaplaceSolver&&) noexcept;

  /// Fills the rows of `values` (n,k) that are not given.
  void solve(Values& values) const;

  /// (n,) vertices whose values must be given.
  const Mask& given() const noexcept;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// (n,) vertices on the boundary of the tet mesh: corners of faces that belong to one tet only. Vertices without a tet count too.
Mask boundary_vertices(ConstTets tets, Eigen::Index vertex_count);

}  // namespace followthrough
