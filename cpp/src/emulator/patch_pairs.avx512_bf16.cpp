// SPDX-License-Identifier: GPL-3.0-or-later
// Hidden layers in bfloat16 for processors whose vector units multiply pairs of them (AVX-512's vdpbf16ps) at twice the rate of
// single precision.
#include "emulator/rounded_layers.hpp"

#include <string.h>

namespace followthrough::avx512_bf16 {
namespace {

// A tile of rows x 32 outputs of a layer.
struct Tile {
  float* sums;  // bias + products (rows, 32)
  std::int64_t output;
  std::int32_t first, rows;
};

// Sums up a tile of as many rows as the template says. Meanwhile the rows of the tile before it are finished one after the other:
// their tanh keeps units of the processor busy that products leave idle.
template <int kRows, typename Finish>
inline void multiply_pairs(const TileLayer& layer, const std::uint16_t* rows, const Tile& tile, const Tile& before,
                           const Finish& finish) {
  const std::int64_t inputs = layer.inputs;
  const std::uint16_t *const in = rows + tile.first * inputs, *const left = layer.weights + tile.output * inputs,
                             *const right = left + 16 * inputs;
  Lanes low[kRows], high[kRows];
  FOLLOWTHROUGH_UNROLL
  for (int r = 0; r < kRows; ++r) {
    low[r] = load(layer.bias + tile.output);
    high[r] = load(layer.bias + tile.output + 16);
  }
  const std::int64_t share = before.rows ? inputs / (2 * before.rows) * 2 : inputs;  // two and more: there are 32 inputs or more
  std::int64_t k = 0;
  for (std::int32_t finished = 0; k < inputs; ++finished) {
    const bool busy = finished < before.rows;
    for (const std::int64_t end = busy ? k + share : inputs; k < end; k += 2) {
      const auto left_weights = (__m512bh)_mm512_loadu_si512(left + 16 * k);
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
    if (busy) finish(before.sums + finished * kTilePanel, before.output, before.first + finished, 1);
  }
  FOLLOWTHROUGH_UNROLL
  for (int r = 0; r < kRows; ++r) {
    store(tile.sums + r * kTilePanel, low[r]);
    store(tile.sums + r * kTilePanel + 16, high[r]);
  }
}

// As many rows as the template says, or fewer.
template <int kRows, typename Finish>
inline void multiply_rows(const TileLayer& layer, const std::uint16_t* rows, const Tile& tile, const Tile& before,
                          const Finish& finish) {
  if constexpr (kRows > 1) {
    if (tile.rows < kRows) {
      multiply_rows<kRows - 1>(layer, rows, tile, before, finish);
      return;
    }
  }
  multiply_pairs<kRows>(layer, rows, tile, before, finish);
}

struct Pairs {
  // A third of the multiply-adds at half the rate.
  static constexpr bool kSplitsSums = false;

  template <typename Finish>
  static void layer(const TileLayer& layer, const std::uint16_t* in, std::int32_t rows, float* sums, const Finish& finish) {
    static_assert(2 * kTileRows <= kTileBlockRows);                 // `sums` holds two tiles
    const std::int32_t tiles = (rows + kTileRows - 1) / kTileRows;  // of about the same height
    Tile before{sums, 0, 0, 0};
    float* free_sums = sums + kTileRows * kTilePanel;
    for (std::int64_t output = 0; output < layer.outputs; output += kTilePanel) {
      for (std::int32_t t = 0; t < tiles; ++t) {
        const std::int32_t first = rows * t / tiles;
        const Tile tile{free_sums, output, first, rows * (t + 1) / tiles - first};
        multiply_rows<kTileRows>(layer, in, tile, before, finish);
        free_sums = before.sums;
        before = tile;
      }
    }
    finish(before.sums, before.output, before.first, before.rows);
  }
};

}  // namespace

void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* memory) noexcept {
  rounded_changes<Pairs>(frame, first, last, memory);
}

void near_tanh(const float* in, float* out, std::int64_t count) noexcept {
  for (std::int64_t i = 0; i < count; i += 16) store(out + i, near_tanh(load(in + i)));
}

}  // namespace followthrough::avx512_bf16
