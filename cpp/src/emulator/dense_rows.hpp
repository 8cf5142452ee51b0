// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Dense layers on rows of floats, for kernel files only: tiles of rows by outputs are summed in registers over all inputs and go
/// through tanh before they are written.
#pragma once

#include "emulator/patch_kernel.hpp"
#include "lanes.hpp"

#if defined(__GNUC__) && !defined(__clang__)
#define FOLLOWTHROUGH_UNROLL _Pragma("GCC unroll 16")
#elif defined(__clang__)
#define FOLLOWTHROUGH_UNROLL _Pragma("unroll")
#else
#define FOLLOWTHROUGH_UNROLL
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// x P(x^2) / Q(x^2), fitted for the least maximal error on [-8, 8] with P(0) = Q(0) = 1 (tests/cpp/emulator/fit_tanh.py); beyond,
// it is 1 to float precision. Off by less than 3.5e-7, relatively as well as absolutely, rounding included.
inline Lanes tanh_of(Lanes x) {
  x = larger(broadcast(-8.0f), smaller(broadcast(8.0f), x));
  const Lanes y = multiply(x, x);
  Lanes p = broadcast(0x1.9c9226p-36f);
  p = multiply_add(p, y, broadcast(-0x1.f87f7p-27f));
  p = multiply_add(p, y, broadcast(0x1.4b3ce6p-17f));
  p = multiply_add(p, y, broadcast(0x1.87436ap-9f));
  p = multiply_add(p, y, broadcast(0x1.09ccd4p-3f));
  p = multiply_add(p, y, broadcast(1.0f));
  Lanes q = broadcast(0x1.f13aep-13f);
  q = multiply_add(q, y, broadcast(0x1.899f6cp-6f));
  q = multiply_add(q, y, broadcast(0x1.da3bb4p-2f));
  q = multiply_add(q, y, broadcast(1.0f));
  return divide(multiply(x, p), q);
}

struct Rows {
  float* data;
  std::int64_t stride;
};

// Rows x Columns registers of outputs; `weights` are those of the first of their panels. The sums start from `bias`, or from what
// is in `out` where it is null.
template <int kRows, int kColumns, bool kTanh>
inline void tile(const float* in, std::int64_t in_stride, const float* weights, std::int64_t inputs, const float* bias, float* out,
                 std::int64_t out_stride) {
  Lanes sums[kRows][kColumns];
  FOLLOWTHROUGH_UNROLL
  for (int c = 0; c < kColumns; ++c) {
    FOLLOWTHROUGH_UNROLL
    for (int r = 0; r < kRows; ++r) sums[r][c] = load((bias ? bias : out + r * out_stride) + c * kLanes);
  }
  for (std::int64_t k = 0; k < inputs; ++k) {
    Lanes w[kColumns];
    FOLLOWTHROUGH_UNROLL
    for (int c = 0; c < kColumns; ++c) {
      const int output = c * kLanes;
      w[c] = load(weights + (output / kPanel) * inputs * kPanel + k * kPanel + output % kPanel);
    }
    FOLLOWTHROUGH_UNROLL
    for (int r = 0; r < kRows; ++r) {
      const Lanes x = broadcast(in[r * in_stride + k]);
      FOLLOWTHROUGH_UNROLL
      for (int c = 0; c < kColumns; ++c) sums[r][c] = multiply_add(x, w[c], sums[r][c]);
    }
  }
  FOLLOWTHROUGH_UNROLL
  for (int r = 0; r < kRows; ++r) {
    FOLLOWTHROUGH_UNROLL
    for (int c = 0; c < kColumns; ++c) {
      store(out + r * out_stride + c * kLanes, kTanh ? tanh_of(sums[r][c]) : sums[r][c]);
    }
  }
}

// As many rows as the template says, or fewer.
template <int kRows, int kColumns, bool kTanh>
inline void tile_of(std::int32_t rows, const float* in, std::int64_t in_stride, const float* weights, std::int64_t inputs,
                    const float* bias, float* out, std::int64_t out_stride) {
  if constexpr (kRows > 1) {
    if (rows < kRows) {
      tile_of<kRows - 1, kColumns, kTanh>(rows, in, in_stride, weights, inputs, bias, out, out_stride);
      return;
    }
  }
  tile<kRows, kColumns, kTanh>(in, in_stride, weights, inputs, bias, out, out_stride);
}

template <bool kTanh>
void dense(const DenseKernel& layer, const float* in, std::int64_t in_stride, float* out, std::int64_t out_stride,
           std::int32_t rows) {
  constexpr std::int32_t columns = kTileColumns * kLanes;
  const std::int32_t tiles = (rows + kTileRows - 1) / kTileRows;  // of about the same height, not one of a row or two at the end
  for (std::int32_t c = 0; c < layer.outputs; c += columns) {
    const float* weights = layer.weights + static_cast<std::int64_t>(c) * layer.inputs;
    for (std::int32_t t = 0; t < tiles; ++t) {
      const std::int32_t first = rows * t / tiles, count = rows * (t + 1) / tiles - first;
      const float* from = in + first * in_stride;
      float* to = out + first * out_stride + c;
      const float* bias = layer.bias ? layer.bias + c : nullptr;
      if (columns <= kPanel || c + columns <= layer.outputs) {
        tile_of<kTileRows, kTileColumns, kTanh>(count, from, in_stride, weights, layer.inputs, bias, to, out_stride);
      } else {
        tile_of < kTileRows, kPanel / kLanes<kTileColumns ? kPanel / kLanes : kTileColumns, kTanh>(
                                          count, from, in_stride, weights, layer.inputs, bias, to, out_stride);
      }
    }
  }
}

// All of a perceptron's layers, each through tanh; the last one writes to `last`. `front` holds the first one's input and, like
// `back`, is as wide as the widest.
void hidden_layers(const DenseKernel* layers, std::int32_t count, const float* in, std::int64_t in_stride, float* front,
                   float* back, Rows last, std::int32_t rows) {
  for (std::int32_t k = 0; k < count; ++k) {
    const bool final_layer = k + 1 == count;
    float* out = final_layer ? last.data : back;
    const std::int64_t out_stride = final_layer ? last.stride : layers[k].outputs;
    dense<true>(layers[k], in, in_stride, out, out_stride, rows);
    in = out;
    in_stride = out_stride;
    back = front;
    front = out;
  }
}

void add_row(float* sum, const float* row, std::int64_t width) {
  for (std::int64_t c = 0; c < width; c += kLanes) store(sum + c, add(load(sum + c), load(row + c)));
}

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
