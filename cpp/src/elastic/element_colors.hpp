// SPDX-License-Identifier: GPL-3.0-or-later
// Splits a mesh's elements among threads so that sums at vertices need neither locks nor a particular number of threads.
#pragma once

#include <array>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// Elements that follow each other in the mesh form a cluster of so many; one thread takes a cluster in order.
constexpr Index cluster_size = 64;

struct ElementColors {
  std::vector<Index> starts;    ///< (colours + 1,) into clusters
  std::vector<Index> clusters;  ///< cluster numbers, by colour: no two clusters of a colour share a vertex
};

ElementColors color_elements(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count);

}  // namespace followthrough
