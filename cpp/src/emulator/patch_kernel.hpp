// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The emulator's inner loops, compiled once per instruction set. Plain arrays only: see cmake/InstructionSets.cmake.
///
/// Every output is bias + input[0] weight[0] + input[1] weight[1] + ..., in this order on every instruction set; those that have
/// fused multiply-adds use them throughout and agree to the bit, the others differ by rounding.
#pragma once

#include <cstdint>

namespace followthrough {

/// Widths of layers are padded to a multiple of this with zeros: tanh(0) = 0, so padding stays zero from layer to layer.
inline constexpr std::int32_t kPanel = 16;
/// Rows (edges or vertices) that go through all layers together. Their activations stay in the first-level cache.
inline constexpr std::int32_t kBlockRows = 24;
/// The same in bfloat16: a tile unit takes tiles two by two.
inline constexpr std::int32_t kTilePanel = 32, kTileBlockRows = 32;

/// A linear layer, packed: weights of outputs [16 p, 16 p + 16) are one panel, input by input.
struct DenseKernel {
  const float* weights;  ///< (outputs / 16, inputs, 16)
  const float* bias;     ///< (outputs,), or null: added to what is there
  std::int32_t inputs;
  std::int32_t outputs;  ///< a multiple of kPanel
};

/// A linear layer of bfloat16 weights: tiles of 32 inputs by 16 outputs, those of the first 16 outputs first, input by input. In a
/// tile, inputs 2 k and 2 k + 1 of an output lie next to each other.
struct TileLayer {
  const std::uint16_t* weights;  ///< (outputs / 16, inputs / 32, 16, 16, 2)
  const float* bias;             ///< (outputs,)
  std::int32_t inputs;           ///< a multiple of kTilePanel
  std::int32_t outputs;          ///< a multiple of kTilePanel
};

/// One ring's force perceptron up to its last tanh.
struct RingKernel {
  DenseKernel neighbour;      ///< features of j -> its share in the first layer; its bias is zero
  DenseKernel centre;         ///< features of i -> its share, the bias included
  const float* offset;        ///< (3, width of the first layer): for o_j - o_i
  const DenseKernel* hidden;  ///< the layers after the first
  std::int32_t hidden_count;
  const TileLayer* hidden_tiles;  ///< the same in bfloat16, or null
  std::int32_t column;            ///< where its sum starts in a joined row
  std::int32_t degree_column;     ///< where the number of neighbours goes
  const std::int32_t* starts;     ///< (free vertices + 1,) into neighbours
  const std::int32_t* neighbours;
  float* shares;  ///< (vertices, width of the first layer)
};

struct PatchFrame {
  const float* features;     ///< (vertices, feature_count)
  const double* origins;     ///< (vertices, 3) o, in the network's units
  const std::int32_t* free;  ///< (free vertices,) their rows in the two above
  std::int32_t feature_count;
  std::int32_t inertia_count, displacement_count, ring_count;  ///< layers; rings
  const DenseKernel* inertia;                                  ///< up to its last tanh; writes to column 0 of a joined row
  const RingKernel* rings;
  const DenseKernel* displacement;      ///< its first layer takes joined rows: the last layers of the others are folded into it
  const TileLayer* inertia_tiles;       ///< all but the first in bfloat16, or null
  const TileLayer* displacement_tiles;  ///< all but the last in bfloat16, or null; the first takes split rows
  std::int32_t joined_width;
  std::int32_t widest;  ///< of all layers but the joined row
  float* changes;       ///< out: (free vertices, 3) u(t+1) - u(t), in the network's units
};

// `scratch` of predict_changes: kBlockRows rows, each of three times the widest, a joined row and the features.
#define FOLLOWTHROUGH_DECLARE_PATCH_KERNELS(isa)                                                                 \
  namespace isa {                                                                                                \
  void neighbour_shares(const PatchFrame& frame, std::int32_t first, std::int32_t last) noexcept;                \
  void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* scratch) noexcept; \
  void rational_tanh(const float* in, float* out, std::int64_t count) noexcept;                                  \
  }
FOLLOWTHROUGH_DECLARE_PATCH_KERNELS(baseline)
FOLLOWTHROUGH_DECLARE_PATCH_KERNELS(avx2)
FOLLOWTHROUGH_DECLARE_PATCH_KERNELS(avx512)
#undef FOLLOWTHROUGH_DECLARE_PATCH_KERNELS

// With the hidden layers in bfloat16. `scratch`: kTileBlockRows rows, each of three times the widest, a panel, two and a half
// joined rows and the features.
namespace amx {
/// On the calling thread's tile unit.
void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* scratch) noexcept;
void near_tanh(const float* in, float* out, std::int64_t count) noexcept;  // a multiple of 16
}  // namespace amx
namespace avx512_bf16 {
void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* scratch) noexcept;
void near_tanh(const float* in, float* out, std::int64_t count) noexcept;
}  // namespace avx512_bf16

}  // namespace followthrough
