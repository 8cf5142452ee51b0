// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/packed_layers.hpp"

#include <algorithm>
#include <new>

namespace followthrough {
namespace {

constexpr std::align_val_t cache_line{64};

}  // namespace

void AlignedFloats::Free::operator()(float* data) const { ::operator delete[](data, cache_line); }

AlignedFloats::AlignedFloats(std::size_t count) : data_(static_cast<float*>(::operator new[](count * sizeof(float), cache_line))) {
  std::fill_n(data_.get(), count, 0.0f);
}

const float* PackedLayers::keep(const std::vector<float>& numbers) {
  numbers_.emplace_back(numbers.size());
  std::copy(numbers.begin(), numbers.end(), numbers_.back().data());
  return numbers_.back().data();
}

DenseKernel PackedLayers::pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias) {
  const Eigen::Index inputs = weight.cols();
  const int outputs = padded_width(weight.rows());
  std::vector<float> panels(static_cast<std::size_t>(outputs * inputs), 0.0f), biases(static_cast<std::size_t>(outputs), 0.0f);
  for (Eigen::Index out = 0; out < weight.rows(); ++out) {
    if (bias.size()) biases[static_cast<std::size_t>(out)] = static_cast<float>(bias[out]);
    for (Eigen::Index in = 0; in < inputs; ++in) {
      panels[static_cast<std::size_t>(((out / kPanel) * inputs + in) * kPanel + out % kPanel)] =
          static_cast<float>(weight(out, in));
    }
  }
  return {keep(panels), bias.size() ? keep(biases) : nullptr, static_cast<std::int32_t>(inputs), outputs};
}

}  // namespace followthrough
