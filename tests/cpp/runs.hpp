// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Comparing results to the bit, and putting back what a test changes for the whole program.
#pragma once

#include <omp.h>

#include <cstddef>
#include <cstring>

#include "followthrough/types.hpp"
#include "instruction_set.hpp"

namespace followthrough {

inline bool same_bits(const Positions& a, const Positions& b) {
  return a.rows() == b.rows() && std::memcmp(a.data(), b.data(), sizeof(double) * static_cast<std::size_t>(a.size())) == 0;
}
inline bool same_bits(const Vector& a, const Vector& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), sizeof(double) * static_cast<std::size_t>(a.size())) == 0;
}

/// Puts the instruction set and the number of threads back.
struct Usual {
  InstructionSet set = instruction_set();
  int threads = omp_get_max_threads();
  ~Usual() {
    use_instruction_set(set);
    omp_set_num_threads(threads);
  }
};

}  // namespace followthrough
