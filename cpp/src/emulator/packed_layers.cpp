// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/packed_layers.hpp"

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>
#include <new>

namespace followthrough {
namespace {

constexpr std::align_val_t cache_line{64};

std::uint16_t to_bfloat16(float number) {
  const auto bits = std::bit_cast<std::uint32_t>(number);
  return static_cast<std::uint16_t>((bits + 0x7fffu + (bits >> 16 & 1u)) >> 16);  // halfway: to even
}

double rounded_to_bfloat16(double number) {
  return static_cast<double>(std::bit_cast<float>(std::uint32_t{to_bfloat16(static_cast<float>(number))} << 16));
}

std::vector<float> padded(const Eigen::VectorXd& numbers, int width) {
  std::vector<float> result(static_cast<std::size_t>(width), 0.0f);
  for (Eigen::Index k = 0; k < numbers.size(); ++k) result[static_cast<std::size_t>(k)] = static_cast<float>(numbers[k]);
  return result;
}

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

DenseKernel PackedLayers::pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias, int panel) {
  const Eigen::Index inputs = weight.cols();
  const int outputs = padded_width(weight.rows(), panel);
  std::vector<float> panels(static_cast<std::size_t>(outputs * inputs), 0.0f);
  for (Eigen::Index out = 0; out < weight.rows(); ++out) {
    for (Eigen::Index in = 0; in < inputs; ++in) {
      panels[static_cast<std::size_t>(((out / kPanel) * inputs + in) * kPanel + out % kPanel)] =
          static_cast<float>(weight(out, in));
    }
  }
  return {keep(panels), bias.size() ? keep(padded(bias, outputs)) : nullptr, static_cast<std::int32_t>(inputs), outputs};
}

TileLayer PackedLayers::pack_tiles(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias) {
  const int inputs = padded_width(weight.cols(), kTilePanel), outputs = padded_width(weight.rows(), kTilePanel);
  std::vector<std::uint16_t> tiles(static_cast<std::size_t>(outputs * inputs), 0);
  for (Eigen::Index out = 0; out < weight.rows(); ++out) {
    for (Eigen::Index in = 0; in < weight.cols(); ++in) {
      const Eigen::Index pair = ((out / 16) * (inputs / 2) + in / 2) * 16 + out % 16;
      tiles[static_cast<std::size_t>(2 * pair + in % 2)] = to_bfloat16(static_cast<float>(weight(out, in)));
    }
  }
  numbers_.emplace_back(tiles.size() / 2);
  std::memcpy(numbers_.back().data(), tiles.data(), tiles.size() * sizeof(std::uint16_t));
  return {reinterpret_cast<const std::uint16_t*>(numbers_.back().data()), keep(padded(bias, outputs)), inputs, outputs};
}

TileLayer PackedLayers::pack_split_tiles(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias) {
  const Eigen::Index block = padded_width(weight.cols(), kTilePanel);
  const Eigen::MatrixXd upper = weight.unaryExpr(&rounded_to_bfloat16);
  Eigen::MatrixXd blocks = Eigen::MatrixXd::Zero(weight.rows(), 3 * block);
  blocks.leftCols(weight.cols()) = upper;
  blocks.middleCols(block, weight.cols()) = upper;
  blocks.middleCols(2 * block, weight.cols()) = weight - upper;
  return pack_tiles(blocks, bias);
}

}  // namespace followthrough
