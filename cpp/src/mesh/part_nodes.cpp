// SPDX-License-Identifier: GPL-3.0-or-later
#include "part_nodes.hpp"

#include <algorithm>
#include <array>

#include "worthwhile_threads.hpp"

namespace followthrough {

PartNodes::PartNodes(const PreparedSurface& prepared, const TriangleTree& triangle_tree, const Voxels& cells)
    : surface(prepared),
      tree(triangle_tree),
      voxels(cells),
      grid(cells.grid),
      stretches(find_stretches(prepared, triangle_tree, cells)) {
  number_patches();
  drop_shallow_overlaps();
  number_pieces();
}

std::size_t PartNodes::touch_of(Index cell, Index triangle) const {
  const auto first = voxels.touch_triangles.begin() + static_cast<std::ptrdiff_t>(touch_begin(cell));
  const auto last = voxels.touch_triangles.begin() + static_cast<std::ptrdiff_t>(touch_end(cell));
  const auto found = std::lower_bound(first, last, triangle);
  return found != last && *found == triangle ? static_cast<std::size_t>(found - voxels.touch_triangles.begin()) : touch_end(cell);
}

void PartNodes::number_patches() {
  const auto cells = static_cast<std::size_t>(grid.count());
  ordinal.assign(cells, kNone);
  for (Index cell = 0; cell < grid.count(); ++cell) {
    if (!voxels.touched(cell)) continue;
    ordinal[static_cast<std::size_t>(cell)] = static_cast<Index>(touched.size());
    touched.push_back(cell);
  }
  touch_nodes.resize(voxels.touch_triangles.size());
  borders.resize(touched.size());
  std::vector<Index> counts(touched.size());
#pragma omp parallel num_threads(worthwhile_threads(std::ssize(voxels.touch_triangles), 100))
  {
    PatchFinder patches_in(surface, voxels);
#pragma omp for schedule(dynamic, 32)
    for (std::size_t k = 0; k < touched.size(); ++k) {
      CellPatches patches = patches_in(touched[k]);
      std::copy(patches.labels.begin(), patches.labels.end(),
                touch_nodes.begin() + static_cast<std::ptrdiff_t>(touch_begin(touched[k])));
      counts[k] = patches.count;
      borders[k] = std::move(patches.borders);
    }
  }
  for (std::size_t k = 0; k < touched.size(); ++k) {
    for (std::size_t touch = touch_begin(touched[k]); touch < touch_end(touched[k]); ++touch) {
      touch_nodes[touch] += static_cast<Index>(count);
    }
    count += static_cast<std::size_t>(counts[k]);
  }
  cell_nodes.assign(cells, kNone);
  for (Index cell = 0; cell < grid.count(); ++cell) {
    if (kept(cell) && !voxels.touched(cell)) cell_nodes[static_cast<std::size_t>(cell)] = static_cast<Index>(count++);
  }
}

std::pair<int, int> PartNodes::cells_along(const Stretch& s) const {
  int first = floor_index(s.from + kTouchDepth), last = floor_index(s.to - kTouchDepth);
  if (first > last) first = last = floor_index(0.5 * (s.from + s.to));
  const int low = grid.low[s.axis], high = low + grid.size[s.axis] - 1;
  first = std::clamp(first, low, high);
  return {first, std::clamp(last, first, high)};
}

// Parts that overlap a little stay apart; where the overlap holds a whole cell, they are one.
void PartNodes::drop_shallow_overlaps() {
  std::erase_if(stretches, [&](const Stretch& s) {
    if (!s.overlap) return false;
    const auto [first, last] = cells_along(s);
    for (int along = first; along <= last; ++along) {
      if (cell_nodes[static_cast<std::size_t>(cell_on(s, along))] != kNone) return false;
    }
    return true;
  });
}

void PartNodes::number_pieces() {
  first_cells.reserve(stretches.size());
  last_cells.reserve(stretches.size());
  first_pieces.reserve(stretches.size());
  for (const Stretch& s : stretches) {
    const auto [first, last] = cells_along(s);
    first_cells.push_back(first);
    last_cells.push_back(last);
    first_pieces.push_back(static_cast<Index>(count));
    count += static_cast<std::size_t>(last - first + 1);
  }
}

Index PartNodes::cell_on(const Stretch& s, int along) const {
  Eigen::Vector3i cell;
  cell[s.axis] = along;
  const int u = (s.axis + 1) % 3, v = (s.axis + 2) % 3;
  cell[u] = grid.low[u] + s.u / kLinesPerCell;
  cell[v] = grid.low[v] + s.v / kLinesPerCell;
  return grid.number(cell);
}

Index PartNodes::node_on(std::size_t stretch, int along) const {
  const Index cell = cell_on(stretches[stretch], along);
  if (!kept(cell)) return kNone;
  const Index whole = cell_nodes[static_cast<std::size_t>(cell)];
  return whole != kNone ? whole : first_pieces[stretch] + along - first_cells[stretch];
}

}  // namespace followthrough
