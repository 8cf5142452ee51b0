// SPDX-License-Identifier: GPL-3.0-or-later
#include "bfloat16_unit.hpp"

#include <algorithm>
#include <atomic>

#include "followthrough/errors.hpp"

#ifdef FOLLOWTHROUGH_HAS_avx512_bf16
#include <cpuid.h>

#include "instruction_set.hpp"
#endif
#ifdef FOLLOWTHROUGH_HAS_amx
#include <sys/syscall.h>
#include <unistd.h>
#endif

namespace followthrough {

#ifdef FOLLOWTHROUGH_HAS_avx512_bf16
namespace {

bool processor_has_pairs() {
  const auto sets = available_instruction_sets();
  if (std::find(sets.begin(), sets.end(), InstructionSet::avx512) == sets.end()) return false;
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  constexpr unsigned avx512_bf16 = 1u << 5;
  return __get_cpuid_count(7, 1, &eax, &ebx, &ecx, &edx) && (eax & avx512_bf16);
}

// No flag tells how fast they are, so the maker decides. AMD's do twice the multiply-adds of single precision (measured on Zen 4,
// the first to have them), Intel's half (Emerald Rapids).
bool pairs_are_fast() {
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  if (!__get_cpuid(0, &eax, &ebx, &ecx, &edx)) return false;
  return ebx == signature_AMD_ebx && ecx == signature_AMD_ecx && edx == signature_AMD_edx;
}

#ifdef FOLLOWTHROUGH_HAS_amx
bool processor_has_tiles() {
  unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
  constexpr unsigned amx_bf16 = 1u << 22, amx_tile = 1u << 24;
  return __get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) && (edx & (amx_bf16 | amx_tile)) == (amx_bf16 | amx_tile);
}

// Linux saves the tiles' eight kilobytes only for processes that have asked for it.
bool system_grants_tiles() {
  constexpr long request_permission = 0x1023, tile_data = 18;  // ARCH_REQ_XCOMP_PERM, XFEATURE_XTILEDATA
  return syscall(SYS_arch_prctl, request_permission, tile_data) == 0;
}
#endif

}  // namespace

std::vector<Bfloat16Unit> available_bfloat16_units() {
  if (!processor_has_pairs()) return {};  // what rounds to bfloat16 comes with them
#ifdef FOLLOWTHROUGH_HAS_amx
  if (processor_has_tiles() && system_grants_tiles()) return {Bfloat16Unit::pairs, Bfloat16Unit::tiles};
#endif
  return {Bfloat16Unit::pairs};
}
#else
namespace {

bool pairs_are_fast() { return false; }

}  // namespace

std::vector<Bfloat16Unit> available_bfloat16_units() { return {}; }
#endif

namespace {

Bfloat16Unit preferred() {
  const std::vector<Bfloat16Unit> units = available_bfloat16_units();
  if (units.empty() || (units.back() == Bfloat16Unit::pairs && !pairs_are_fast())) return Bfloat16Unit::none;
  return units.back();
}

std::atomic<Bfloat16Unit>& chosen() {
  static std::atomic<Bfloat16Unit> unit{preferred()};
  return unit;
}

}  // namespace

Bfloat16Unit bfloat16_unit() noexcept { return chosen().load(std::memory_order_relaxed); }

void use_bfloat16_unit(Bfloat16Unit unit) {
  const std::vector<Bfloat16Unit> units = available_bfloat16_units();
  if (unit != Bfloat16Unit::none && std::find(units.begin(), units.end(), unit) == units.end()) {
    throw InvalidInput("bfloat16 unit", "found one that this machine does not have, expected one that it has");
  }
  chosen().store(unit, std::memory_order_relaxed);
}

void require_bfloat16_unit() {
  if (bfloat16_unit() == Bfloat16Unit::none) {
    throw InvalidInput(
        "precision",
        "found bfloat16, which needs a processor with AMX (Intel Xeon from Sapphire Rapids on, under Linux) or AMD's with "
        "AVX-512 (from Zen 4 on); this machine has neither or does not grant it: use float32");
  }
}

}  // namespace followthrough
