// SPDX-License-Identifier: GPL-3.0-or-later
// The patch network with its hidden layers in bfloat16, for processors with a unit that multiplies tiles (Intel's AMX). Weights and
// what goes into a layer are rounded to bfloat16, products are summed in single precision. First layers of edges and vertices and
// the last layer of all stay in single precision, and the layer that takes the sums over neighbours keeps 16 bits of them. Tile
// products and tanh take turns: interleaved finely, they hold each other up.
#include "emulator/patch_kernel.hpp"

#include "emulator/patch_rows.hpp"

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

// As tanh_of, but a fit of lower degree on [-5.2, 5.2] and without a division. Off by less than 1.5e-4, far below what rounding to
// bfloat16 does.
inline Lanes near_tanh(Lanes x) {
  x = larger(broadcast(-5.2f), smaller(broadcast(5.2f), x));
  const Lanes y = multiply(x, x);
  Lanes p = broadcast(0x1.5667bp-11f);
  p = multiply_add(p, y, broadcast(0x1.a15206p-4f));
  p = multiply_add(p, y, broadcast(1.0f));
  Lanes q = broadcast(0x1.9e8308p-7f);
  q = multiply_add(q, y, broadcast(0x1.bd5636p-2f));
  q = multiply_add(q, y, broadcast(1.0f));
  return multiply(multiply(x, p), _mm512_rcp14_ps(q));
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

// Two registers, rounded to the nearest bfloat16.
inline void store_rounded(std::uint16_t* to, Lanes low, Lanes high) {
  _mm512_storeu_si512(to, (__m512i)_mm512_cvtne2ps_pbh(high, low));
}

// Two registers as sums of two bfloat16: upper, lower and upper again, a block apart, as PackedLayers::pack_split_tiles wants them.
inline void store_split(std::uint16_t* to, std::int64_t block, Lanes low, Lanes high) {
  const __m512i upper = (__m512i)_mm512_cvtne2ps_pbh(high, low);
  const auto number = [](__m256i halves) { return _mm512_castsi512_ps(_mm512_slli_epi32(_mm512_cvtepu16_epi32(halves), 16)); };
  store_rounded(to + block, subtract(low, number(_mm512_castsi512_si256(upper))),
                subtract(high, number(_mm512_extracti64x4_epi64(upper, 1))));
  _mm512_storeu_si512(to, upper);
  _mm512_storeu_si512(to + 2 * block, upper);
}

// What becomes of 32 outputs of a layer: the next one's input,
struct ToActivations {
  std::uint16_t* data;
  std::int64_t stride;

  void operator()(const float* sums, std::int64_t output, std::int32_t rows) const {
    for (std::int32_t row = 0; row < rows; ++row, sums += kTilePanel) {
      store_rounded(data + row * stride + output, near_tanh(load(sums)), near_tanh(load(sums + 16)));
    }
  }
};

// or rows of floats,
struct ToRows {
  Rows to;

  void operator()(const float* sums, std::int64_t output, std::int32_t rows) const {
    for (std::int32_t row = 0; row < rows; ++row, sums += kTilePanel) {
      float* out = to.data + row * to.stride + output;
      store(out, near_tanh(load(sums)));
      store(out + 16, near_tanh(load(sums + 16)));
    }
  }
};

// or part of the sums of the vertices that the rows' edges leave.
struct ToSums {
  Rows to;
  const std::int32_t* vertices;

  void operator()(const float* sums, std::int64_t output, std::int32_t rows) const {
    for (std::int32_t row = 0; row < rows;) {
      const std::int32_t vertex = vertices[row];
      float* out = to.data + vertex * to.stride + output;
      Lanes low = load(out), high = load(out + 16);
      for (; row < rows && vertices[row] == vertex; ++row, sums += kTilePanel) {
        low = add(low, near_tanh(load(sums)));
        high = add(high, near_tanh(load(sums + 16)));
      }
      store(out, low);
      store(out + 16, high);
    }
  }
};

template <typename Finish>
void tile_layer(const TileLayer& layer, const std::uint16_t* in, std::int32_t rows, float* sums, const Finish& finish) {
  for (std::int64_t output = 0; output < layer.outputs; output += kTilePanel) {
    multiply_tiles(layer, output, in, rows, sums);
    finish(sums, output, rows);
  }
}

// `front` holds the first layer's input.
template <typename Finish>
void tile_layers(const TileLayer* layers, std::int32_t count, std::uint16_t* front, std::uint16_t* back, std::int32_t rows,
                 float* sums, const Finish& finish) {
  for (std::int32_t k = 0; k + 1 < count; ++k) {
    tile_layer(layers[k], front, rows, sums, ToActivations{back, layers[k].outputs});
    std::uint16_t* const taken = front;
    front = back;
    back = taken;
  }
  tile_layer(layers[count - 1], front, rows, sums, finish);
}

// Parts of a thread's memory.
struct Scratch {
  Scratch(const PatchFrame& frame, float* memory) {
    const auto take = [&](std::int64_t floats) {
      float* taken = memory;
      memory += floats;
      return taken;
    };
    const std::int64_t widest = frame.widest;
    sums = take(kTileBlockRows * kTilePanel);
    front = reinterpret_cast<std::uint16_t*>(take(kTileBlockRows * widest / 2));
    back = reinterpret_cast<std::uint16_t*>(take(kTileBlockRows * widest / 2));
    rows = take(kTileBlockRows * widest);
    centre_shares = take(kTileBlockRows * widest);
    split = reinterpret_cast<std::uint16_t*>(take(kTileBlockRows * 3 * std::int64_t{frame.joined_width} / 2));
    joined = {take(std::int64_t{kTileBlockRows} * frame.joined_width), frame.joined_width};
    features = memory;
  }
  float* sums;
  std::uint16_t *front, *back, *split;
  float *rows, *centre_shares;
  Rows joined;
  float* features;
};

void first_edge_layer(const PatchFrame& frame, const RingKernel& ring, std::int32_t block_first, std::int32_t edge,
                      std::int32_t rows, const std::int32_t* vertices, const Scratch& scratch) {
  const std::int64_t width = ring.centre.outputs;
  for (std::int32_t row = 0; row < rows; ++row) {
    const EdgeSum sum = edge_sum(frame, ring, block_first, vertices[row], edge + row, scratch.centre_shares);
    for (std::int64_t c = 0; c < width; c += kTilePanel) {
      store_rounded(scratch.front + row * width + c, near_tanh(sum.at(c)), near_tanh(sum.at(c + 16)));
    }
  }
}

void tile_ring_sums(const PatchFrame& frame, const RingKernel& ring, std::int32_t first, std::int32_t vertices,
                    const Scratch& scratch) {
  begin_ring(frame, ring, first, vertices, scratch.features, scratch.centre_shares, scratch.joined);
  const std::int32_t end = ring.starts[first + vertices];
  std::int32_t vertex = 0, vertex_of[kTileBlockRows];
  for (std::int32_t edge = ring.starts[first]; edge < end; edge += kTileBlockRows) {
    const std::int32_t rows = end - edge < kTileBlockRows ? end - edge : kTileBlockRows;
    for (std::int32_t row = 0; row < rows; ++row) {
      while (edge + row >= ring.starts[first + vertex + 1]) ++vertex;
      vertex_of[row] = vertex;
    }
    first_edge_layer(frame, ring, first, edge, rows, vertex_of, scratch);
    const Rows to{scratch.joined.data + ring.column, scratch.joined.stride};
    tile_layers(ring.hidden_tiles, ring.hidden_count, scratch.front, scratch.back, rows, scratch.sums, ToSums{to, vertex_of});
  }
}

// The inertia perceptron's hidden layers.
void inertia_layers(const PatchFrame& frame, std::int32_t vertices, const Scratch& scratch) {
  const DenseKernel& first = frame.inertia[0];
  const std::int32_t others = frame.inertia_count - 1;
  const std::int64_t width = first.outputs;
  const Rows to = others ? Rows{scratch.rows, width} : scratch.joined;
  dense<true>(first, scratch.features, frame.feature_count, to.data, to.stride, vertices);
  if (!others) return;
  for (std::int64_t k = 0; k < vertices * width; k += kTilePanel) {
    store_rounded(scratch.front + k, load(scratch.rows + k), load(scratch.rows + k + 16));
  }
  tile_layers(frame.inertia_tiles, others, scratch.front, scratch.back, vertices, scratch.sums, ToRows{scratch.joined});
}

// The displacement perceptron's hidden layers.
void displacement_layers(const PatchFrame& frame, std::int32_t vertices, const Scratch& scratch, Rows to) {
  const std::int64_t width = frame.joined_width;
  for (std::int64_t v = 0; v < vertices; ++v) {
    for (std::int64_t c = 0; c < width; c += kTilePanel) {
      const float* from = scratch.joined.data + v * width + c;
      store_split(scratch.split + 3 * v * width + c, width, load(from), load(from + 16));
    }
  }
  tile_layers(frame.displacement_tiles, frame.displacement_count - 1, scratch.split, scratch.back, vertices, scratch.sums,
              ToRows{to});
}

}  // namespace

void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* memory) noexcept {
  const Scratch scratch(frame, memory);
  configure_tiles();
  for (; first < last; first += kTileBlockRows) {
    const std::int32_t vertices = last - first < kTileBlockRows ? last - first : kTileBlockRows;
    gather_features(frame, first, vertices, scratch.features);
    for (std::int32_t r = 0; r < frame.ring_count; ++r) {
      const RingKernel& ring = frame.rings[r];
      if (ring.hidden_count) {
        tile_ring_sums(frame, ring, first, vertices, scratch);
      } else {
        ring_sums(frame, ring, first, vertices, scratch.features, scratch.rows, scratch.rows, scratch.centre_shares,
                  scratch.joined);
      }
    }
    inertia_layers(frame, vertices, scratch);
    const Rows hidden{scratch.centre_shares, frame.displacement[frame.displacement_count - 2].outputs};
    displacement_layers(frame, vertices, scratch, hidden);
    write_changes(frame, first, vertices, hidden, scratch.rows);
  }
  _tile_release();
}

}  // namespace followthrough::amx
