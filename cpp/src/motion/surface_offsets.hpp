// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The surface's share of a frame where bones blend linearly: embedding and inverse skinning (see stretch_solve) of many vertices
/// at once. Compiled once per instruction set, plain arrays only: see cmake/InstructionSets.cmake.
#pragma once

#include <cstdint>

#include "skinning/bone_rows.hpp"

namespace followthrough {

/// One frame of a surface of v vertices.
struct SurfaceFrame {
  const double* moved;              ///< (n,4) displacements of the volume's vertices in the world, m; the fourth number is 0
  const std::int32_t* corners;      ///< (v,4) of the tet that carries a vertex
  const double* embedding_weights;  ///< (v,4)
  BoneRows bones;                   ///< of the first vertex, 12 columns; the others' indices and weights follow
  double least_total_weight;        ///< a vertex whose weights sum to no more stays put
  double to_object[9];              ///< from the world to the object's space, row by row
  double to_world[9];               ///< and back
  double minimum_stretch;
  double* displacements;  ///< out: (v,3) in the world, m
  double* offsets;        ///< out: (v,3) in the object's space at rest
  float* rounded;         ///< out: the offsets; where it is not null, the other two may be, and are not written
};

/// What the kernel found in its vertices.
struct SurfaceShare {
  bool usable = true;                 ///< false where a weight or index cannot be used, or an offset is not finite as it is written
  double displacement_squared = 0.0;  ///< largest, m²
  double residual_squared = 0.0;      ///< largest that is left of a displacement, m²
  std::int64_t flattened = 0;         ///< vertices whose offsets are not written, because stretches may have to be clamped
};

#define FOLLOWTHROUGH_DECLARE_SURFACE_KERNELS(isa)                                                                            \
  namespace isa {                                                                                                             \
  /* Vertices first to last - 1. `flattened` takes the numbers of those that are left to the caller, last - first at most. */ \
  SurfaceShare surface_offsets(const SurfaceFrame& frame, std::int64_t first, std::int64_t last,                              \
                               std::int32_t* flattened) noexcept;                                                             \
  }
FOLLOWTHROUGH_DECLARE_SURFACE_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_SURFACE_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_SURFACE_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_SURFACE_KERNELS

}  // namespace followthrough
