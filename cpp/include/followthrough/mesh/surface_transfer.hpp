// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Bone weights and painted values carried from a surface into the volume around it [ZS 3.1].
#pragma once

#include <memory>

#include "followthrough/types.hpp"

namespace followthrough {

/// @brief Carries values from a surface's vertices to those of a tet mesh: vertices on the volume's boundary take the value of the
/// closest point of the surface, those inside the solution of Laplace's equation between them.
///
/// Results stay in the range of the surface's values; what is non-negative and sums to one stays so.
class SurfaceTransfer {
 public:
  /// @param surface_vertices (v,3) m
  /// @param triangles (t,3)
  /// @param vertices (n,3) the tet mesh, m, in the same place
  /// @param tets (m,4)
  /// @param own_offsets (n + 1,) with `own_triangles`: the surface triangles of each vertex's own part, as in TetVolume; a vertex
  /// that
  ///   has some looks for its closest point there only. Empty: everywhere.
  /// @param own_triangles see `own_offsets`
  /// @throws InvalidInput on empty or non-finite arrays or an index out of range
  SurfaceTransfer(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets,
                  ConstIndices own_offsets, ConstIndices own_triangles);
  ~SurfaceTransfer();
  SurfaceTransfer(SurfaceTransfer&&) noexcept;
  SurfaceTransfer& operator=(SurfaceTransfer&&) noexcept;

  /// @param values (v,k) on the surface's vertices
  /// @return (n,k) on the tet mesh's vertices
  /// @throws InvalidInput on a wrong number of rows or non-finite values
  Values operator()(ConstValues values) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace followthrough
