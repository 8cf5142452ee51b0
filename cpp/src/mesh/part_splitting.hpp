// SPDX-License-Identifier: GPL-3.0-or-later
// Cells that hold more than one part of the body, made into one copy for each [virtual nodes, Molino et al. 2004].
#pragma once

#include <vector>

#include "cube_tets.hpp"
#include "prepared_surface.hpp"
#include "triangle_tree.hpp"
#include "voxels.hpp"

namespace followthrough {

struct SplitCubes {
  Cubes cubes;
  std::vector<Index> touch_cubes;  ///< cube that carries each row of Voxels::touch_triangles
};

/// @brief Gives each part of the body in a cell a cube of its own.
///
/// What hangs together in a cell is one part of it: triangles that share an edge or vertex inside the cell; sheets with material
/// between them, which lines through the body (`find_stretches`) and looks from sheet to sheet through the material tell, whatever
/// the gap or small overlap to the next part. A cell without any triangle is one part. Cubes of neighbouring cells share the grid's
/// vertices between them where they carry the same triangle or a line passes from one to the other through material; elsewhere the
/// vertices are doubled.
///
/// Different pieces of the mesh (eyes, clothes, buttons) are glued where they overlap. A piece that overlaps nothing is glued, cell
/// by cell, to the nearest surface of a larger piece, where that is in the same or a neighbouring cell and no farther than a cell's
/// edge: a trouser leg to the thigh inside it, but not to the other one.
SplitCubes split_parts(const PreparedSurface& surface, const TriangleTree& tree, const Voxels& voxels);

}  // namespace followthrough
