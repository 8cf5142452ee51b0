// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/errors.hpp"

#include <cmath>

namespace followthrough {

InvalidInput::InvalidInput(std::string_view argument, std::string_view problem)
    : std::invalid_argument(std::string(argument) + ": " + std::string(problem)), argument_(argument) {}

void require_finite(std::string_view argument, ConstValues values) {
  for (Eigen::Index row = 0; row < values.rows(); ++row) {
    for (Eigen::Index column = 0; column < values.cols(); ++column) {
      if (!std::isfinite(values(row, column))) {
        throw InvalidInput(
            argument, "row " + std::to_string(row) + " holds " + std::to_string(values(row, column)) + ", expected finite numbers");
      }
    }
  }
}

void require_indices(std::string_view argument, ConstIndexTable indices, Eigen::Index count) {
  for (Eigen::Index row = 0; row < indices.rows(); ++row) {
    for (Eigen::Index column = 0; column < indices.cols(); ++column) {
      const Index index = indices(row, column);
      if (index < 0 || index >= count) {
        throw InvalidInput(argument, "row " + std::to_string(row) + " holds index " + std::to_string(index) + ", expected 0 to " +
                                         std::to_string(count - 1));
      }
    }
  }
}

void require_rows(std::string_view argument, Eigen::Index found, Eigen::Index expected) {
  if (found != expected) {
    throw InvalidInput(argument, "has " + std::to_string(found) + " rows, expected " + std::to_string(expected));
  }
}

}  // namespace followthrough
