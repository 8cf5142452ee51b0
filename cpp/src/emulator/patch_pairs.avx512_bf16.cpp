// SPDX-License-Identifier: GPL-3.0-or-later
// Hidden layers in bfloat16 for processors whose vector units multiply pairs of them (AVX-512's vdpbf16ps) at twice the rate of
// single precision.
#include "emulator/rounded_layers.hpp"

#include <string.h>

namespace followthrough::avx512_bf16 {
namespace {

// Rows x 32 outputs, bias + products, to `sums` (rows, 32).
template <int kRows>
inline void multiply_pairs(const std::uint16_t* in, std::int64_t inputs, const std::uint16_t* weights, const float* bias,
                           float* sums) {
  const std::uint16_t* const right = weights + 16 * inputs;
  Lanes low[kRows], high[kRows];
  FOLLOWTHROUGH_UNROLL
  for (int r = 0; r < kRows; ++r) {
    low[r] = load(bias);
    high[r] = load(bias + 16);
  }
  for (std::int64_t k = 0; k < inputs; k += 2) {
    const auto left_weights = (__m512bh)_mm512_loadu_si512(weights + 16 * k);
    const auto right_weights = (__m512bh)_mm512_loadu_si512(right + 16 * k);
    FOLLOWTHROUGH_UNROLL
    for (int r = 0; r < kRows; ++r) {
      int pair;
      memcpy(&pair, in + r * inputs + k, sizeof pair);
      const auto x = (__m512bh)_mm512_set1_epi32(pair);
      low[r] = _mm512_dpbf16_ps(low[r], left_weights, x);
      high[r] = _mm512_dpbf16_ps(high[r], right_weights, x);
    }
  }
  FOLLOWTHROUGH_UNROLL
  for (int r = 0; r < kRows; ++r) {
    store(sums + r * kTilePanel, low[r]);
    store(sums + r * kTilePanel + 16, high[r]);
  }
}

// As many rows as the template says, or fewer.
template <int kRows>
inline void multiply_rows(std::int32_t rows, const std::uint16_t* in, std::int64_t inputs, const std::uint16_t* weights,
                          const float* bias, float* sums) {
  if constexpr (kRows > 1) {
    if (rows < kRows) {
      multiply_rows<kRows - 1>(rows, in, inputs, weights, bias, sums);
      return;
    }
  }
  multiply_pairs<kRows>(in, inputs, weights, bias, sums);
}

struct Pairs {
  // A third of the multiply-adds at half the rate.
  static constexpr bool kSplitsSums = false;

  template <typename Finish>
  static void layer(const TileLayer& layer, const std::uint16_t* in, std::int32_t rows, float* sums, const Finish& finish) {
    const std::int64_t inputs = layer.inputs;
    const std::int32_t tiles = (rows + kTileRows - 1) / kTileRows;  // of about the same height
    for (std::int64_t output = 0; output < layer.outputs; output += kTilePanel) {
      for (std::int32_t t = 0; t < tiles; ++t) {
        const std::int32_t first = rows * t / tiles, count = rows * (t + 1) / tiles - first;
        multiply_rows<kTileRows>(count, in + first * inputs, inputs, layer.weights + output * inputs, layer.bias + output, sums);
        finish(sums, output, first, count);
      }
    }
  }
};

}  // namespace

void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* memory) noexcept {
  rounded_changes<Pairs>(frame, first, last, memory);
}

}  // namespace followthrough::avx512_bf16
