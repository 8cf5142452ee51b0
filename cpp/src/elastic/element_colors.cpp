// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/element_colors.hpp"

#include <algorithm>

namespace followthrough {

ElementColors color_elements(const std::vector<std::array<Index, 4>>& corners, Eigen::Index vertex_count) {
  const auto count = static_cast<Index>(corners.size());
  const Index clusters = (count + cluster_size - 1) / cluster_size;
  std::vector<std::vector<Index>> colors_at(static_cast<std::size_t>(vertex_count));
  std::vector<std::vector<Index>> by_color;
  std::vector<Index> taken_by;  // last cluster that may not have the colour
  for (Index cluster = 0; cluster < clusters; ++cluster) {
    const auto first = corners.begin() + cluster * cluster_size;
    const auto last = corners.begin() + std::min((cluster + 1) * cluster_size, count);
    for (auto tet = first; tet != last; ++tet) {
      for (const Index v : *tet) {
        for (const Index color : colors_at[v]) taken_by[color] = cluster;
      }
    }
    const auto color = static_cast<Index>(
        std::find_if(taken_by.begin(), taken_by.end(), [&](Index owner) { return owner != cluster; }) - taken_by.begin());
    if (color == static_cast<Index>(by_color.size())) {
      by_color.emplace_back();
      taken_by.push_back(-1);
    }
    by_color[color].push_back(cluster);
    for (auto tet = first; tet != last; ++tet) {
      for (const Index v : *tet) {
        if (colors_at[v].empty() || colors_at[v].back() != color) colors_at[v].push_back(color);
      }
    }
  }
  ElementColors result{{0}, {}};
  for (const std::vector<Index>& same : by_color) {
    result.clusters.insert(result.clusters.end(), same.begin(), same.end());
    result.starts.push_back(static_cast<Index>(result.clusters.size()));
  }
  return result;
}

}  // namespace followthrough
