// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The volume carried along by a surface that anything may move (lattices, mesh deform, corrective keys): harmonic coordinates
/// inside.
#pragma once

#include <memory>

#include "followthrough/types.hpp"

namespace followthrough {

/// @brief Moves a tet mesh with an evaluated surface. Vertices on the volume's boundary hang on the closest point of the surface,
/// and their way from there turns with the surface around it; those inside follow harmonically.
///
/// A rigid motion of the surface moves the volume by the same one. Factored once; a frame is one back-substitution.
class SurfaceFollower {
 public:
  /// Arguments as for SurfaceTransfer. All positions must be in the same space, with the same unit on every axis.
  SurfaceFollower(ConstPositions surface_vertices, ConstTriangles triangles, ConstPositions vertices, ConstTets tets,
                  ConstIndices own_offsets, ConstIndices own_triangles);
  ~SurfaceFollower();
  SurfaceFollower(SurfaceFollower&&) noexcept;
  SurfaceFollower& operator=(SurfaceFollower&&) noexcept;

  /// @param positions (v,3) the surface's vertices as they are now
  /// @return (n,3) the tet mesh's vertices
  /// @throws InvalidInput on a wrong number of rows or non-finite positions
  Positions operator()(ConstPositions positions) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace followthrough
