// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Linear layers as the kernels want them, and the memory that holds them.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include <Eigen/Core>

#include "emulator/patch_kernel.hpp"

namespace followthrough {

/// Floats that start at a cache line.
class AlignedFloats {
 public:
  AlignedFloats() = default;
  explicit AlignedFloats(std::size_t count);
  float* data() const { return data_.get(); }

 private:
  struct Free {
    void operator()(float* data) const;
  };
  std::unique_ptr<float[], Free> data_;
};

/// @return the next multiple of a panel
inline int padded_width(Eigen::Index width, int panel = kPanel) { return static_cast<int>((width + panel - 1) / panel) * panel; }

/// Owns what it packs.
class PackedLayers {
 public:
  const float* keep(const std::vector<float>& numbers);
  /// @param bias (outputs,), or empty: a layer that adds to what is there
  /// @param panel the outputs become a multiple of it, and it is one of kPanel
  DenseKernel pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias, int panel = kPanel);
  /// The weights rounded to the nearest bfloat16.
  TileLayer pack_tiles(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias);
  /// Keeps 16 significant bits: a number is the sum of two bfloat16, `upper` and what is left, `lower`. Inputs are three blocks,
  /// upper, lower and upper again, which meet the upper, upper and lower parts of the weights. A block is a multiple of kTilePanel.
  TileLayer pack_split_tiles(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias);

 private:
  std::vector<AlignedFloats> numbers_;
};

}  // namespace followthrough
