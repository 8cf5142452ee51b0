// SPDX-License-Identifier: GPL-3.0-or-later
#include "instruction_set.hpp"

#include <algorithm>
#include <atomic>
#include <cstdlib>
#include <string>

#include "followthrough/errors.hpp"

#if defined(_MSC_VER) && defined(_M_X64)
#include <immintrin.h>
#include <intrin.h>
#endif

namespace followthrough {
namespace {

#if defined(_MSC_VER) && defined(_M_X64)
bool processor_has(InstructionSet set) {
  int leaf[4];
  __cpuid(leaf, 0);
  if (leaf[0] < 7) {
    return false;
  }
  __cpuid(leaf, 1);
  const bool saves_registers = (leaf[2] & (1 << 27)) != 0;  // OSXSAVE
  const bool fma = (leaf[2] & (1 << 12)) != 0;
  const unsigned long long saved = saves_registers ? _xgetbv(0) : 0;
  __cpuidex(leaf, 7, 0);
  const auto ebx = static_cast<unsigned>(leaf[1]);
  const unsigned avx2 = (1u << 5) | (1u << 3) | (1u << 8);                                 // AVX2, BMI1, BMI2
  const unsigned avx512 = (1u << 16) | (1u << 17) | (1u << 28) | (1u << 30) | (1u << 31);  // F, DQ, CD, BW, VL
  switch (set) {
    case InstructionSet::baseline:
      return true;
    case InstructionSet::avx2:
      return fma && (ebx & avx2) == avx2 && (saved & 0x6) == 0x6;
    case InstructionSet::avx512:
      return fma && (ebx & avx2) == avx2 && (ebx & avx512) == avx512 && (saved & 0xe6) == 0xe6;
  }
  return false;
}
#elif defined(__x86_64__)
bool processor_has(InstructionSet set) {
  __builtin_cpu_init();
  const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi") &&
                    __builtin_cpu_supports("bmi2");
  switch (set) {
    case InstructionSet::baseline:
      return true;
    case InstructionSet::avx2:
      return avx2;
    case InstructionSet::avx512:
      return avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
             __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
  }
  return false;
}
#else
bool processor_has(InstructionSet set) { return set == InstructionSet::baseline; }
#endif

InstructionSet preferred() {
  const std::vector<InstructionSet> sets = available_instruction_sets();
  if (const char* wanted = std::getenv("FOLLOWTHROUGH_INSTRUCTION_SET")) {
    for (const InstructionSet set : sets) {
      if (name_of(set) == wanted) {
        return set;
      }
    }
  }
  return sets.back();
}

std::atomic<InstructionSet>& chosen() {
  static std::atomic<InstructionSet> set{preferred()};
  return set;
}

}  // namespace

std::vector<InstructionSet> available_instruction_sets() {
  std::vector<InstructionSet> sets{InstructionSet::baseline};
#ifdef FOLLOWTHROUGH_HAS_avx2
  if (processor_has(InstructionSet::avx2)) {
    sets.push_back(InstructionSet::avx2);
  }
#endif
#ifdef FOLLOWTHROUGH_HAS_avx512
  if (processor_has(InstructionSet::avx512)) {
    sets.push_back(InstructionSet::avx512);
  }
#endif
  return sets;
}

InstructionSet instruction_set() noexcept { return chosen().load(std::memory_order_relaxed); }

void use_instruction_set(InstructionSet set) {
  const std::vector<InstructionSet> sets = available_instruction_sets();
  if (std::find(sets.begin(), sets.end(), set) == sets.end()) {
    throw InvalidInput("instruction set", "found " + std::string(name_of(set)) + ", expected one that this machine has");
  }
  chosen().store(set, std::memory_order_relaxed);
}

std::string_view name_of(InstructionSet set) noexcept {
  switch (set) {
    case InstructionSet::avx2:
      return "avx2";
    case InstructionSet::avx512:
      return "avx512";
    default:
      return "baseline";
  }
}

}  // namespace followthrough
