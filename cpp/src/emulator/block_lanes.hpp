// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Blocks of nine floats, wherever they start in memory, in registers: for kernel files only.
#pragma once

#include "emulator/lanes.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

/// to[k] += from[k] for nine floats; what is read of `from` may reach seven floats farther.
#if defined(__AVX512F__)
inline void add_block(float* to, const float* from) {
  constexpr __mmask16 nine = 0x1ff;
  _mm512_mask_storeu_ps(to, nine, _mm512_add_ps(_mm512_maskz_loadu_ps(nine, to), _mm512_loadu_ps(from)));
}
#else
inline void add_block(float* to, const float* from) {
  for (int k = 0; k + kLanes <= 8; k += kLanes) store(to + k, add(load(to + k), load(from + k)));
  for (int k = 8 / kLanes * kLanes; k < 9; ++k) to[k] += from[k];
}
#endif

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
