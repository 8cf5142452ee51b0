// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The one rule for how many threads a parallel loop takes. Waking and joining a thread costs microseconds on an idle machine and a
/// whole time slice, milliseconds, on a busy one: a loop is split only where each share is long beside that.
#pragma once

#include <omp.h>

#include <algorithm>
#include <cstddef>

namespace followthrough {

/// @brief For `#pragma omp parallel for num_threads(worthwhile_threads(count, cost))`.
/// @param count items of the loop
/// @param nanoseconds what one item takes on one core, roughly: a factor of two does not matter
/// @param least_share of work that a thread is worth, nanoseconds: less than a quarter of a millisecond only where loops follow
/// each other so closely that threads are still awake, and give up where they find the machine busy (team_barrier.hpp)
/// @return 1 to the number of threads that is set, so many that each has as much work or more
inline int worthwhile_threads(std::ptrdiff_t count, double nanoseconds, double least_share = 250'000) {
  const double shares = static_cast<double>(count) * nanoseconds / least_share;
  const int most = omp_get_max_threads();
  return shares >= most ? most : std::max(1, static_cast<int>(shares));
}

}  // namespace followthrough
