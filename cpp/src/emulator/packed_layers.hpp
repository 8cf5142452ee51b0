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

/// @return the next multiple of kPanel
inline int padded_width(Eigen::Index width) { return static_cast<int>((width + kPanel - 1) / kPanel) * kPanel; }

/// Owns what it packs.
class PackedLayers {
 public:
  const float* keep(const std::vector<float>& numbers);
  /// @param bias (outputs,), or empty: a layer that adds to what is there
  DenseKernel pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias);

 private:
  std::vector<AlignedFloats> numbers_;
};

}  // namespace followthrough
