// SPDX-License-Identifier: GPL-3.0-or-later
// Small tet meshes for the elastic tests.
#pragma once

#include "followthrough/types.hpp"

namespace followthrough {

struct TetBlock {
  Positions vertices;
  Tets tets;
};

/// A box of cubes, six tets each.
inline TetBlock tet_block(int nx, int ny, int nz, double edge) {
  const auto vertex = [&](int x, int y, int z) { return static_cast<Index>((x * (ny + 1) + y) * (nz + 1) + z); };
  TetBlock block{Positions((nx + 1) * (ny + 1) * (nz + 1), 3), Tets(6 * nx * ny * nz, 4)};
  for (int x = 0; x <= nx; ++x) {
    for (int y = 0; y <= ny; ++y) {
      for (int z = 0; z <= nz; ++z) block.vertices.row(vertex(x, y, z)) << edge * x, edge * y, edge * z;
    }
  }
  Eigen::Index tet = 0;
  const int cube[6][4] = {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}};  // bits: x y z
  for (int x = 0; x < nx; ++x) {
    for (int y = 0; y < ny; ++y) {
      for (int z = 0; z < nz; ++z) {
        for (const auto& corners : cube) {
          for (int k = 0; k < 4; ++k) {
            block.tets(tet, k) = vertex(x + (corners[k] >> 2), y + (corners[k] >> 1 & 1), z + (corners[k] & 1));
          }
          ++tet;
        }
      }
    }
  }
  return block;
}

}  // namespace followthrough
