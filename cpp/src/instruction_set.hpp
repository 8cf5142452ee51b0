// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Which of the kernels compiled per instruction set (cmake/InstructionSets.cmake) runs on this machine.
#pragma once

#include <string_view>
#include <vector>

namespace followthrough {

enum class InstructionSet { baseline, avx2, avx512 };

/// @return the sets that are both compiled in and supported by this processor, the simplest first; never empty
std::vector<InstructionSet> available_instruction_sets();

/// @brief The set that kernels run with: the last one of available_instruction_sets, unless use_instruction_set or the environment
///   variable FOLLOWTHROUGH_INSTRUCTION_SET (baseline, avx2, avx512; read once) asked for a simpler one.
InstructionSet instruction_set() noexcept;

/// @brief Overrides the choice for the whole process. For tests and benchmarks: results do not depend on it.
/// @throws InvalidInput where the set is not available here
void use_instruction_set(InstructionSet set);

std::string_view name_of(InstructionSet set) noexcept;

}  // namespace followthrough
