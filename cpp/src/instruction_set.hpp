// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Which of the kernels compiled per instruction set (cmake/InstructionSets.cmake) runs on this machine.
#pragma once

#include <string_view>
#include <type_traits>
#include <vector>

#ifdef FOLLOWTHROUGH_HAS_avx2
#define FOLLOWTHROUGH_AVX2_KERNEL(kernel) avx2::kernel
#else
#define FOLLOWTHROUGH_AVX2_KERNEL(kernel) nullptr
#endif
#ifdef FOLLOWTHROUGH_HAS_avx512
#define FOLLOWTHROUGH_AVX512_KERNEL(kernel) avx512::kernel
#else
#define FOLLOWTHROUGH_AVX512_KERNEL(kernel) nullptr
#endif
/// The function of this name that is compiled for the set that kernels run with.
#define FOLLOWTHROUGH_KERNEL(kernel) \
  ::followthrough::kernel_of_set(baseline::kernel, FOLLOWTHROUGH_AVX2_KERNEL(kernel), FOLLOWTHROUGH_AVX512_KERNEL(kernel))
/// Likewise where there are several of that name: the one that a pointer of this type takes.
#define FOLLOWTHROUGH_KERNEL_OF_TYPE(pointer, kernel)                                                                 \
  ::followthrough::kernel_of_set<std::remove_pointer_t<pointer>>(baseline::kernel, FOLLOWTHROUGH_AVX2_KERNEL(kernel), \
                                                                 FOLLOWTHROUGH_AVX512_KERNEL(kernel))

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

/// One of a kernel's three (FOLLOWTHROUGH_KERNEL), of which those are null that are not compiled in.
template <typename Kernel>
Kernel* kernel_of_set(Kernel* baseline, std::type_identity_t<Kernel*> avx2, std::type_identity_t<Kernel*> avx512) noexcept {
  switch (instruction_set()) {
    case InstructionSet::avx512:
      return avx512;
    case InstructionSet::avx2:
      return avx2;
    default:
      return baseline;
  }
}

}  // namespace followthrough
