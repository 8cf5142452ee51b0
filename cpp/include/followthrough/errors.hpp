// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Bad input is an answer, not a crash: every public function throws InvalidInput before it has changed anything. Python sees a
/// ValueError.
#pragma once

#include <stdexcept>
#include <string>
#include <string_view>

#include "followthrough/types.hpp"

namespace followthrough {

/// An argument that cannot be used. The message names the argument, what was found and what was expected.
class InvalidInput : public std::invalid_argument {
 public:
  InvalidInput(std::string_view argument, std::string_view problem);
  /// Name of the offending argument.
  const std::string& argument() const noexcept { return argument_; }

 private:
  std::string argument_;
};

/// @throws InvalidInput naming the first row that holds NaN or infinity.
void require_finite(std::string_view argument, ConstValues values);

/// @throws InvalidInput where an entry lies outside [0, count), naming the row and the value.
void require_indices(std::string_view argument, ConstIndexTable indices, Eigen::Index count);

/// @throws InvalidInput where `found` rows are not the `expected` ones.
void require_rows(std::string_view argument, Eigen::Index found, Eigen::Index expected);

}  // namespace followthrough
