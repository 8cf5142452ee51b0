// SPDX-License-Identifier: GPL-3.0-or-later
// Union-find. The lowest member stands for its set, so results do not depend on the order of joining.
#pragma once

#include <algorithm>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t count) : parent_(count) {
    for (std::size_t k = 0; k < count; ++k) parent_[k] = static_cast<Index>(k);
  }

  Index find(Index item) {
    while (parent_[static_cast<std::size_t>(item)] != item) {
      Index& parent = parent_[static_cast<std::size_t>(item)];
      parent = parent_[static_cast<std::size_t>(parent)];
      item = parent;
    }
    return item;
  }

  void join(Index a, Index b) {
    a = find(a);
    b = find(b);
    if (a != b) parent_[static_cast<std::size_t>(std::max(a, b))] = std::min(a, b);
  }

  /// Numbers the sets from 0 in the order of their lowest members.
  std::vector<Index> labels(Index& count) {
    std::vector<Index> result(parent_.size());
    count = 0;
    for (std::size_t k = 0; k < parent_.size(); ++k) {
      const Index root = find(static_cast<Index>(k));
      result[k] = root == static_cast<Index>(k) ? count++ : result[static_cast<std::size_t>(root)];
    }
    return result;
  }

 private:
  std::vector<Index> parent_;
};

}  // namespace followthrough
