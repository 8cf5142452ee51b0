// SPDX-License-Identifier: GPL-3.0-or-later
// An order of vertices in which those that follow each other lie close together.
#pragma once

#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// @brief Halves the vertices again and again across the longest side of their box. Every run of `smallest` of them that starts at
///   a multiple of it is compact, and so are those of twice, four times, ... to `largest`.
/// @param positions (n,3)
/// @param vertices to sort, each once; ties in space are broken by number
/// @param smallest, largest powers of two
void order_compactly(ConstPositions positions, std::ptrdiff_t smallest, std::ptrdiff_t largest, std::vector<Index>& vertices);

}  // namespace followthrough
