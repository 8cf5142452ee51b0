// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdint>

namespace followthrough {

/// Groups of 16 rows that follow each other and form an aggregate: rows that move as one in a coarse system.
inline constexpr std::int32_t aggregate_groups = 4;

}  // namespace followthrough
