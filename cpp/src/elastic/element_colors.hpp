// SPDX-License-Identifier: GPL-3.0-or-later
// Splits a mesh's elements among threads so that sums at vertices need neither locks nor a particular number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <vector>

#include "followthrough/types.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {

/// Elements that follow each other in the mesh form a cluster of so many; one thread takes a cluster in order.
constexpr Index cluster_size = 64;

struct ElementColors {
  std::vector<Index> starts;    ///< (colours + 1,) into clusters
  std::vector<Index> clusters;  ///< cluster numbers, by colour: no two clusters of a colour share a vertex
};

ElementColors color_elements(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count);

/// Calls work(cluster, first element, one after its last) for all clusters; those at work at a time share no vertex. Threads meet
/// after every colour, so it is a colour that must be worth them.
template <typename Work>
void for_clusters(const std::vector<Index>& starts, const std::vector<Index>& clusters, std::size_t element_count,
                  double element_nanoseconds, const Work& work) {
  const std::size_t colors = starts.size() - 1;
  const int threads = worthwhile_threads(static_cast<std::ptrdiff_t>(element_count / colors), element_nanoseconds);
#pragma omp parallel num_threads(threads)
  for (std::size_t color = 0; color < colors; ++color) {
#pragma omp for schedule(static)
    for (Index k = starts[color]; k < starts[color + 1]; ++k) {
      const auto cluster = static_cast<std::size_t>(clusters[k]);
      work(cluster, cluster * cluster_size, std::min((cluster + 1) * cluster_size, element_count));
    }
  }
}

}  // namespace followthrough
