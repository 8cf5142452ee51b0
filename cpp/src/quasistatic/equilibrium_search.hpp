// SPDX-License-Identifier: GPL-3.0-or-later
// Newton's method for one pose's equilibrium: downhill in the total energy, safe where a material has none.
#pragma once

#include <memory>
#include <vector>

#include "elastic/block_matrix.hpp"
#include "elastic/conjugate_gradients.hpp"
#include "elastic/sparse_cholesky.hpp"
#include "followthrough/quasistatic/quasistatic.hpp"

namespace followthrough {

/// What stays the same over all poses, and room to work in.
struct EquilibriumProblem {
  ElasticBody body;  ///< the tets that have a free vertex: the others pull at nothing that moves
  std::shared_ptr<const Material> material;
  EquilibriumSettings settings;
  StaticForces forces;            ///< pin_stiffness always (n,)
  std::vector<Index> rows, free;  ///< row of every vertex or -1; vertex of every row
  Vector rest_stiffness;          ///< of every row, pins included, N/m
  BlockMatrix pins, matrix;
  SparseCholesky factor;
  BlockDiagonal diagonal;  ///< where single precision has no factor
};

/// @brief The equilibrium for a reference.
/// @param carried (n,3) where to start rather than from the reference, if the energy is lower there; null: nowhere
Positions find_equilibrium(EquilibriumProblem& problem, ConstPositions reference, const Positions* carried, StepReport& report);

}  // namespace followthrough
