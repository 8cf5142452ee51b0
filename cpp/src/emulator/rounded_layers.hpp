// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The patch network with its hidden layers in bfloat16, for kernel files of AVX-512 only; which unit of the processor takes the
/// products is theirs to say. Weights and what goes into a layer are rounded to bfloat16, products are summed in single precision.
/// First layers of edges and vertices and the last layer of all stay in single precision, and the layer that takes the sums over
/// neighbours keeps 16 bits of them or more.
#pragma once

#include "emulator/patch_kernel.hpp"
#include "emulator/patch_rows.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// Parabolas of |x| for near_tanh, from the constant on.
alignas(64) const float kTanhPieces[3][16] = {
    {0.51035285f, 0.73080587f, 0.86324173f, 0.93391955f, 0.97798985f, 0.0f, -0.00023894596f, -0.0011505033f, -0.0041895611f,
     -0.012053791f, -0.021619638f, -0.027977614f, -0.019265905f, 0.04186466f, 0.15691085f, 0.30105653f},
    {0.38158727f, 0.17745903f, 0.077779345f, 0.032991741f, 0.0092508849f, 1.000223f, 1.0083106f, 1.0229247f, 1.0538535f, 1.1046437f,
     1.1488678f, 1.1718811f, 1.1484874f, 1.0193895f, 0.82569164f, 0.62468255f},
    {-0.077344194f, -0.03004621f, -0.011278421f, -0.0041800439f, -0.00098025508f, -0.024368571f, -0.092600025f, -0.15117264f,
     -0.22968264f, -0.31168151f, -0.3627885f, -0.38361168f, -0.36796305f, -0.29971239f, -0.21810764f, -0.14798787f}};

// Off by less than 2.1e-4, and relatively by 2.3e-4, a tenth of what rounding to bfloat16 does; odd, never falling, within 1.
// Permutations instead of most of the multiply-adds, so that products and this can share a processor's units
// (tests/cpp/emulator/fit_tanh.py).
inline Lanes near_tanh(Lanes x) {
  const __m512i sign = _mm512_set1_epi32(static_cast<int>(0x80000000u));
  const __m512i bits = _mm512_castps_si512(x);
  const Lanes size = smaller(broadcast(4.6874995f), _mm512_castsi512_ps(_mm512_andnot_si512(sign, bits)));
  const __m512i piece = _mm512_srli_epi32(_mm512_castps_si512(add(size, broadcast(0.3125f))), 21);  // its last four digits count
  const auto coefficient = [piece](int power) { return _mm512_permutexvar_ps(piece, _mm512_load_ps(kTanhPieces[power])); };
  const Lanes result = multiply_add(multiply_add(coefficient(2), size, coefficient(1)), size, coefficient(0));
  return _mm512_castsi512_ps(_mm512_ternarylogic_epi32(_mm512_castps_si512(result), bits, sign, 0xf8));  // result | (x & sign)
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

// What becomes of 32 outputs of a layer's rows from `first` on, (rows, 32) in `sums`: the next one's input,
struct ToActivations {
  std::uint16_t* data;
  std::int64_t stride;

  void operator()(const float* sums, std::int64_t output, std::int32_t first, std::int32_t rows) const {
    for (std::int32_t row = first; row < first + rows; ++row, sums += kTilePanel) {
      store_rounded(data + row * stride + output, near_tanh(load(sums)), near_tanh(load(sums + 16)));
    }
  }
};

// or rows of floats,
struct ToRows {
  Rows to;

  void operator()(const float* sums, std::int64_t output, std::int32_t first, std::int32_t rows) const {
    for (std::int32_t row = first; row < first + rows; ++row, sums += kTilePanel) {
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

  void operator()(const float* sums, std::int64_t output, std::int32_t first, std::int32_t rows) const {
    for (std::int32_t row = first; row < first + rows;) {
      const std::int32_t vertex = vertices[row];
      float* out = to.data + vertex * to.stride + output;
      Lanes low = load(out), high = load(out + 16);
      for (; row < first + rows && vertices[row] == vertex; ++row, sums += kTilePanel) {
        low = add(low, near_tanh(load(sums)));
        high = add(high, near_tanh(load(sums + 16)));
      }
      store(out, low);
      store(out + 16, high);
    }
  }
};

// `front` holds the first layer's input.
template <typename Unit, typename Finish>
void rounded_layers(const TileLayer* layers, std::int32_t count, std::uint16_t* front, std::uint16_t* back, std::int32_t rows,
                    float* sums, const Finish& finish) {
  for (std::int32_t k = 0; k + 1 < count; ++k) {
    Unit::layer(layers[k], front, rows, sums, ToActivations{back, layers[k].outputs});
    std::uint16_t* const taken = front;
    front = back;
    back = taken;
  }
  Unit::layer(layers[count - 1], front, rows, sums, finish);
}

// Rows that follow each other closely.
inline void round_rows(Rows from, std::int32_t rows, std::uint16_t* to) {
  for (std::int64_t k = 0; k < rows * from.stride; k += kTilePanel) {
    store_rounded(to + k, load(from.data + k), load(from.data + k + 16));
  }
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

template <typename Unit>
void rounded_ring_sums(const PatchFrame& frame, const RingKernel& ring, std::int32_t first, std::int32_t vertices,
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
    rounded_layers<Unit>(ring.hidden_tiles, ring.hidden_count, scratch.front, scratch.back, rows, scratch.sums,
                         ToSums{to, vertex_of});
  }
}

// The inertia perceptron's hidden layers.
template <typename Unit>
void inertia_layers(const PatchFrame& frame, std::int32_t vertices, const Scratch& scratch) {
  const DenseKernel& first = frame.inertia[0];
  const std::int32_t others = frame.inertia_count - 1;
  const std::int64_t width = first.outputs;
  const Rows to = others ? Rows{scratch.rows, width} : scratch.joined;
  dense<true>(first, scratch.features, frame.feature_count, to.data, to.stride, vertices);
  if (!others) return;
  round_rows(to, vertices, scratch.front);
  rounded_layers<Unit>(frame.inertia_tiles, others, scratch.front, scratch.back, vertices, scratch.sums, ToRows{scratch.joined});
}

// The displacement perceptron's hidden layers.
template <typename Unit>
void displacement_layers(const PatchFrame& frame, std::int32_t vertices, const Scratch& scratch, Rows to) {
  const std::int32_t hidden = frame.displacement_count - 1;
  if constexpr (Unit::kSplitsSums) {
    const std::int64_t width = frame.joined_width;
    for (std::int64_t v = 0; v < vertices; ++v) {
      for (std::int64_t c = 0; c < width; c += kTilePanel) {
        const float* from = scratch.joined.data + v * width + c;
        store_split(scratch.split + 3 * v * width + c, width, load(from), load(from + 16));
      }
    }
    rounded_layers<Unit>(frame.displacement_tiles, hidden, scratch.split, scratch.back, vertices, scratch.sums, ToRows{to});
  } else {
    const DenseKernel& first = frame.displacement[0];
    const Rows rows = hidden > 1 ? Rows{scratch.rows, first.outputs} : to;
    dense<true>(first, scratch.joined.data, scratch.joined.stride, rows.data, rows.stride, vertices);
    if (hidden == 1) return;
    round_rows(rows, vertices, scratch.front);
    rounded_layers<Unit>(frame.displacement_tiles + 1, hidden - 1, scratch.front, scratch.back, vertices, scratch.sums, ToRows{to});
  }
}

// What the kernels do. Unit::layer computes a layer, Unit::kSplitsSums says how the one that takes the sums over neighbours is
// computed: from two bfloat16 a number, or in single precision.
template <typename Unit>
void rounded_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* memory) {
  const Scratch scratch(frame, memory);
  for (; first < last; first += kTileBlockRows) {
    const std::int32_t vertices = last - first < kTileBlockRows ? last - first : kTileBlockRows;
    gather_features(frame, first, vertices, scratch.features);
    for (std::int32_t r = 0; r < frame.ring_count; ++r) {
      const RingKernel& ring = frame.rings[r];
      if (ring.hidden_count) {
        rounded_ring_sums<Unit>(frame, ring, first, vertices, scratch);
      } else {
        ring_sums(frame, ring, first, vertices, scratch.features, scratch.rows, scratch.rows, scratch.centre_shares,
                  scratch.joined);
      }
    }
    inertia_layers<Unit>(frame, vertices, scratch);
    const Rows hidden{scratch.centre_shares, frame.displacement[frame.displacement_count - 2].outputs};
    displacement_layers<Unit>(frame, vertices, scratch, hidden);
    write_changes(frame, first, vertices, hidden, scratch.rows);
  }
}

}  // namespace
}  // namespace followthrough::FOLLOWTHROUGH_ISA
