// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// What of the processor multiplies numbers of bfloat16 faster than those of single precision.
#pragma once

#include <vector>

namespace followthrough {

enum class Bfloat16Unit {
  none,
  pairs,  ///< AVX-512's products of pairs, vdpbf16ps
  tiles,  ///< products of tiles, Intel's AMX, which a process has to ask the system for
};

/// @return what there are kernels for, the processor has and the system lets this process use
std::vector<Bfloat16Unit> available_bfloat16_units();

/// @brief What kernels run on: tiles before pairs, and pairs only on processors where they are faster than single precision, unless
///   use_bfloat16_unit asked for something else.
Bfloat16Unit bfloat16_unit() noexcept;

/// @brief Overrides the choice for the whole process. For tests and benchmarks.
/// @throws InvalidInput where it is not available here
void use_bfloat16_unit(Bfloat16Unit unit);

/// @throws InvalidInput about the `precision` that needs one, where there is none
void require_bfloat16_unit();

}  // namespace followthrough
