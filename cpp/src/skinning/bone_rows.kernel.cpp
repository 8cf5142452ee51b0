// SPDX-License-Identifier: GPL-3.0-or-later
#include "skinning/bone_rows_sum.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {

double sum_bone_matrices(const BoneRows& rows, double* sum, bool& valid) noexcept { return sum_rows<12, false>(rows, sum, valid); }

double sum_bone_quaternions(const BoneRows& rows, double* sum, bool& valid) noexcept {
  return sum_rows<20, true>(rows, sum, valid);
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
