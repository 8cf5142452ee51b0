// SPDX-License-Identifier: GPL-3.0-or-later
// A box in a volume of tets, shaken once: its bottom is held, the rest hangs on springs. Prints how far its top lags behind.
#include <algorithm>
#include <cstdio>
#include <exception>
#include <numbers>

#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "followthrough/springs/springs.hpp"

namespace ft = followthrough;

int main() try {
  // The surface: a box of 1 x 1 x 2 metres.
  ft::Positions vertices(8, 3);
  vertices << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 2, 1, 0, 2, 1, 1, 2, 0, 1, 2;
  ft::Triangles triangles(12, 3);
  triangles << 0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7;

  ft::VoxelSettings settings;
  settings.cells = 10;
  const ft::TetVolume volume = ft::tetrahedralize(vertices, triangles, settings);
  std::printf("%d cells, %d tets\n", static_cast<int>(volume.cell_count), static_cast<int>(volume.tets.rows()));

  // Springs: 2 Hz at a tenth of critical damping, pinned at the bottom.
  const double frequency = 2.0 * 2.0 * std::numbers::pi;
  const Eigen::Index count = volume.vertices.rows();
  ft::Mask pinned(count);
  for (Eigen::Index v = 0; v < count; ++v) {
    pinned[v] = volume.vertices(v, 2) < 0.5 * volume.cell_size;
  }
  const double dt = 1.0 / 24.0;
  ft::Springs springs(ft::Vector::Constant(count, frequency * frequency), ft::Vector::Constant(count, 0.2 * frequency), dt, pinned);

  // The motion: half a metre to the right within half a second, then still.
  const auto reference = [&](int frame) {
    const double t = std::min(frame * dt / 0.5, 1.0);
    ft::Positions moved = volume.vertices;
    moved.col(0).array() += 0.5 * t * t * (3.0 - 2.0 * t);
    return moved;
  };
  springs.reset(reference(0));
  for (int frame = 1; frame <= 36; ++frame) {
    const ft::Positions here = reference(frame);
    const ft::Positions next = reference(frame + 1);
    const ft::Values displacement =
        ft::interpolate(springs.step(here, &next) - here, volume.tets, volume.embedding_tets, volume.embedding_weights);
    std::printf("frame %2d: top %+.4f m, bottom %+.4f m\n", frame, displacement(4, 0), displacement(0, 0));
  }
  return 0;
} catch (const std::exception& error) {
  std::fprintf(stderr, "shaken_box: %s\n", error.what());
  return 1;
}
