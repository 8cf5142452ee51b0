// SPDX-License-Identifier: GPL-3.0-or-later
// A tree of axis-aligned boxes over any items. The order of the items and every query are the same on every machine and thread
// count.
#pragma once

#include <algorithm>
#include <array>
#include <limits>
#include <vector>

#include <Eigen/Geometry>

#include "followthrough/types.hpp"

namespace followthrough {

using Box = Eigen::AlignedBox3d;

struct BoxTreeNode {
  Box box;
  Index first = 0;   ///< first item of the node, in `items`
  Index count = 0;   ///< number of items of the node
  Index right = -1;  ///< second child; the first one is the next node; -1: a leaf
};

class BoxTree {
 public:
  explicit BoxTree(const std::vector<Box>& boxes, Index leaf_size = 4) {
    items_.reserve(boxes.size());
    if (boxes.empty()) return;
    std::vector<Centre> centres(boxes.size());
    for (std::size_t item = 0; item < boxes.size(); ++item) {
      for (int axis = 0; axis < 3; ++axis) centres[item].at[axis] = boxes[item].min()[axis] + boxes[item].max()[axis];
      centres[item].item = static_cast<Index>(item);
    }
    nodes_.reserve(4 * boxes.size() / static_cast<std::size_t>(leaf_size) + 2);
    build(boxes, centres, 0, static_cast<Index>(boxes.size()), leaf_size);
  }

  const std::vector<BoxTreeNode>& nodes() const noexcept { return nodes_; }
  const std::vector<Index>& items() const noexcept { return items_; }

  /// Calls `visit(item)` for every item of a leaf whose box overlaps the given one.
  template <typename Visit>
  void overlapping(const Box& query, Visit&& visit) const {
    if (nodes_.empty()) return;
    std::array<Index, 128> stack;
    int top = 0;
    stack[0] = 0;
    while (top >= 0) {
      const Index index = stack[static_cast<std::size_t>(top--)];
      const BoxTreeNode& node = nodes_[static_cast<std::size_t>(index)];
      if (!node.box.intersects(query)) continue;
      if (node.right < 0) {
        for (Index k = node.first; k < node.first + node.count; ++k) visit(items_[static_cast<std::size_t>(k)]);
      } else {
        stack[static_cast<std::size_t>(++top)] = node.right;
        stack[static_cast<std::size_t>(++top)] = index + 1;
      }
    }
  }

  /// Finds the item with the smallest `squared_distance(item)`, of equal ones the one of lowest number. -1 where there is none.
  template <typename Distance>
  Index nearest(const Eigen::Vector3d& point, Distance&& squared_distance) const {
    Index best = -1;
    double best_distance = std::numeric_limits<double>::infinity();
    if (nodes_.empty()) return best;
    std::array<std::pair<double, Index>, 128> stack;
    int top = 0;
    stack[0] = {nodes_[0].box.squaredExteriorDistance(point), 0};
    while (top >= 0) {
      const auto [bound, index] = stack[static_cast<std::size_t>(top--)];
      if (bound > best_distance) continue;
      const BoxTreeNode& node = nodes_[static_cast<std::size_t>(index)];
      if (node.right < 0) {
        for (Index k = node.first; k < node.first + node.count; ++k) {
          const Index item = items_[static_cast<std::size_t>(k)];
          const double distance = squared_distance(item);
          if (distance < best_distance || (distance == best_distance && item < best)) {
            best = item;
            best_distance = distance;
          }
        }
        continue;
      }
      const double left = nodes_[static_cast<std::size_t>(index + 1)].box.squaredExteriorDistance(point);
      const double right = nodes_[static_cast<std::size_t>(node.right)].box.squaredExteriorDistance(point);
      if (left <= right) {
        stack[static_cast<std::size_t>(++top)] = {right, node.right};
        stack[static_cast<std::size_t>(++top)] = {left, index + 1};
      } else {
        stack[static_cast<std::size_t>(++top)] = {left, index + 1};
        stack[static_cast<std::size_t>(++top)] = {right, node.right};
      }
    }
    return best;
  }

 private:
  struct Centre {
    double at[3];  // twice the centre of the item's box
    Index item;
  };

  // Halves the items by their boxes' centres along the longest side: the depth is at most log2 of their number.
  void build(const std::vector<Box>& boxes, std::vector<Centre>& centres, Index first, Index count, Index leaf_size) {
    const std::size_t self = nodes_.size();
    nodes_.emplace_back();
    nodes_[self].first = first;
    nodes_[self].count = count;
    const auto begin = centres.begin() + first, end = begin + count;
    if (count <= leaf_size) {
      for (auto centre = begin; centre != end; ++centre) {
        nodes_[self].box.extend(boxes[static_cast<std::size_t>(centre->item)]);
        items_.push_back(centre->item);
      }
      return;
    }
    double least[3], most[3];
    for (int axis = 0; axis < 3; ++axis) least[axis] = most[axis] = begin->at[axis];
    for (auto centre = begin; centre != end; ++centre) {
      for (int axis = 0; axis < 3; ++axis) {
        least[axis] = std::min(least[axis], centre->at[axis]);
        most[axis] = std::max(most[axis], centre->at[axis]);
      }
    }
    int longest = 0;
    for (const int axis : {1, 2}) {
      if (most[axis] - least[axis] > most[longest] - least[longest]) longest = axis;
    }
    const Index half = count / 2;
    std::nth_element(begin, begin + half, end, [longest](const Centre& a, const Centre& b) {
      return a.at[longest] < b.at[longest] || (a.at[longest] == b.at[longest] && a.item < b.item);
    });
    build(boxes, centres, first, half, leaf_size);
    nodes_[self].right = static_cast<Index>(nodes_.size());
    build(boxes, centres, first + half, count - half, leaf_size);
    nodes_[self].box = nodes_[self + 1].box.merged(nodes_[static_cast<std::size_t>(nodes_[self].right)].box);
  }

  std::vector<BoxTreeNode> nodes_;
  std::vector<Index> items_;
};

}  // namespace followthrough
