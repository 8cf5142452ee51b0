// SPDX-License-Identifier: GPL-3.0-or-later
// Hidden layers in bfloat16 for processors with a unit that multiplies tiles (Intel's AMX). Tile products and tanh take turns:
// interleaved finely, they hold each other up.
#include "emulator/rounded_layers.hpp"

namespace followthrough::amx {
namespace {

constexpr std::int32_t kTileHeight = 16, kTileInputs = 32, kTileBytes = 64;

// The compiler does not know what tile instructions read and write.
inline void memory_fence() { __asm__ volatile("" ::: "memory"); }

// All eight tiles are 16 rows of 64 bytes.
void configure_tiles() {
  struct alignas(64) {
    std::uint8_t palette = 1, start_row = 0, reserved[14] = {};
    std::uint16_t row_bytes[16] = {};
    std::uint8_t rows[16] = {};
  } configuration;
  for (int tile = 0; tile < 8; ++tile) {
    configuration.row_bytes[tile] = kTileBytes;
    configuration.rows[tile] = kTileHeight;
  }
  __asm__ volatile("" : : "r"(&configuration) : "memory");  // all of it is read
  _tile_loadconfig(&configuration);
}

// 32 outputs of a layer, bias + products, to `sums` (rows, 32). Rows are read and written up to the next multiple of 32.
inline void multiply_tiles(const TileLayer& layer, std::int64_t output, const std::uint16_t* in, std::int32_t rows, float* sums) {
  const std::int64_t inputs = layer.inputs, in_bytes = 2 * inputs;
  constexpr std::int32_t out_bytes = 4 * kTilePanel;
  memory_fence();
  for (std::int32_t row = 0; row < rows; row += 2 * kTileHeight) {
    const std::uint16_t *upper = in + row * inputs, *lower = upper + kTileHeight * inputs;
    const std::uint16_t *left = layer.weights + output * inputs, *right = left + 16 * inputs;
    _tile_loadd(0, layer.bias + output, 0);
    _tile_loadd(1, layer.bias + output + 16, 0);
    _tile_loadd(2, layer.bias + output, 0);
    _tile_loadd(3, layer.bias + output + 16, 0);
    for (std::int64_t k = 0; k < inputs; k += kTileInputs) {
      _tile_loadd(4, upper + k, in_bytes);
      _tile_loadd(5, lower + k, in_bytes);
      _tile_loadd(6, left + 16 * k, kTileBytes);
      _tile_loadd(7, right + 16 * k, kTileBytes);
      _tile_dpbf16ps(0, 4, 6);
      _tile_dpbf16ps(1, 4, 7);
      _tile_dpbf16ps(2, 5, 6);
      _tile_dpbf16ps(3, 5, 7);
    }
    float *upper_out = sums + row * kTilePanel, *lower_out = upper_out + kTileHeight * kTilePanel;
    _tile_stored(0, upper_out, out_bytes);
    _tile_stored(1, upper_out + 16, out_bytes);
    _tile_stored(2, lower_out, out_bytes);
    _tile_stored(3, lower_out + 16, out_bytes);
  }
  memory_fence();
}

struct Tiles {
  // Single precision would take longer than three times the inputs.
  static constexpr bool kSplitsSums = true;

  template <typename Finish>
  static void layer(const TileLayer& layer, const std::uint16_t* in, std::int32_t rows, float* sums, const Finish& finish) {
    for (std::int64_t output = 0; output < layer.outputs; output += kTilePanel) {
      multiply_tiles(layer, output, in, rows, sums);
      finish(sums, output, 0, rows);
    }
  }
};

}  // namespace

void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* memory) noexcept {
  configure_tiles();
  rounded_changes<Tiles>(frame, first, last, memory);
  _tile_release();
}

void near_tanh(const float* in, float* out, std::int64_t count) noexcept {
  for (std::int64_t i = 0; i < count; i += 16) store(out + i, near_tanh(load(in + i)));
}

}  // namespace followthrough::amx
