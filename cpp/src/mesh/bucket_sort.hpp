// SPDX-License-Identifier: GPL-3.0-or-later
// Sorting in linear time where a whole number says nearly everything about the order.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace followthrough {

/// @brief Sorts by bucket, and by `less` in each bucket; equal items keep their order.
/// @param buckets their number
/// @param bucket_of an item's bucket, 0 to `buckets` - 1
template <typename Item, typename BucketOf, typename Less>
std::vector<Item> bucket_sorted(const std::vector<Item>& items, std::size_t buckets, BucketOf&& bucket_of, Less&& less) {
  std::vector<std::uint32_t> ends(buckets + 1, 0);
  for (const Item& item : items) ++ends[static_cast<std::size_t>(bucket_of(item)) + 1];
  for (std::size_t b = 1; b <= buckets; ++b) ends[b] += ends[b - 1];
  std::vector<Item> sorted(items.size());
  for (const Item& item : items) sorted[ends[static_cast<std::size_t>(bucket_of(item))]++] = item;  // now really the ends
  constexpr std::size_t few = 24;
  for (std::size_t b = 0, first = 0; b < buckets; first = ends[b++]) {
    if (ends[b] - first > few) {
      std::stable_sort(sorted.begin() + static_cast<std::ptrdiff_t>(first), sorted.begin() + static_cast<std::ptrdiff_t>(ends[b]),
                       less);
      continue;
    }
    for (std::size_t k = first + 1; k < ends[b]; ++k) {
      const Item item = sorted[k];
      std::size_t place = k;
      for (; place > first && less(item, sorted[place - 1]); --place) sorted[place] = sorted[place - 1];
      sorted[place] = item;
    }
  }
  return sorted;
}

}  // namespace followthrough
