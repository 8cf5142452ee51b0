// SPDX-License-Identifier: GPL-3.0-or-later
#include "tile_unit.hpp"

#include "followthrough/errors.hpp"

#ifdef FOLLOWTHROUGH_HAS_amx
#include <cpuid.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>

#include "instruction_set.hpp"
#endif

namespace followthrough {

#ifdef FOLLOWTHROUGH_HAS_amx
namespace {

bool processor_has_tiles() {
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  if (!__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx)) return false;
  constexpr unsigned amx_bf16 = 1u << 22, amx_tile = 1u << 24, avx512_bf16 = 1u << 5;
  if ((edx & (amx_bf16 | amx_tile)) != (amx_bf16 | amx_tile)) return false;
  return __get_cpuid_count(7, 1, &eax, &ebx, &ecx, &edx) && (eax & avx512_bf16);
}

// Linux saves the tiles' eight kilobytes only for processes that have asked for it.
bool system_grants_tiles() {
  constexpr long request_permission = 0x1023, tile_data = 18;  // ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA
  return syscall(SYS_arch_prctl, request_permission, tile_data) == 0;
}

bool find_tile_unit() {
  const auto sets = available_instruction_sets();
  const bool avx512 = std::find(sets.begin(), sets.end(), InstructionSet::avx512) != sets.end();
  return avx512 && processor_has_tiles() && system_grants_tiles();
}

}  // namespace

bool has_tile_unit() noexcept {
  static const bool found = find_tile_unit();
  return found;
}
#else
bool has_tile_unit() noexcept { return false; }
#endif

void require_tile_unit() {
  if (!has_tile_unit()) {
    throw InvalidInput(
        "precision",
        "found bfloat16, which needs a processor with AMX (Intel Xeon from Sapphire Rapids on) and Linux; this machine "
        "has none or does not grant it: use float32");
  }
}

}  // namespace followthrough
