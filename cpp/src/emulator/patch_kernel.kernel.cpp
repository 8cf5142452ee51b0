// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes of a register are outputs of a layer, so a sum over neighbours never crosses lanes. A tile of rows by outputs is summed in
// registers over all inputs and goes through tanh before it is written; a block of rows goes through all layers before the next
// one.
#include "emulator/patch_kernel.hpp"

#include "emulator/lanes.hpp"

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

// Rows x Columns registers of outputs; `weights` are those of the first of their panels.
template <int kRows, int kColumns, bool kTanh>
inline void tile(const float* in, std::int64_t in_stride, const float* weights, std::int64_t inputs, const float* bias, float* out,
                 std::int64_t out_stride) {
  Lanes sums[kRows][kColumns];
  FOLLOWTHROUGH_UNROLL
  for (int c = 0; c < kColumns; ++c) {
    const Lanes start = load(bias + c * kLanes);
    FOLLOWTHROUGH_UNROLL
    for (int r = 0; r < kRows; ++r) sums[r][c] = start;
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
      if (columns <= kPanel || c + columns <= layer.outputs) {
        tile_of<kTileRows, kTileColumns, kTanh>(count, from, in_stride, weights, layer.inputs, layer.bias + c, to, out_stride);
      } else {
        tile_of < kTileRows, kPanel / kLanes<kTileColumns ? kPanel / kLanes : kTileColumns, kTanh>(
                                          count, from, in_stride, weights, layer.inputs, layer.bias + c, to, out_stride);
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

// First layer of the edges [first, first + rows), `vertex` being the block's vertex that the first of them belongs to.
void first_edge_layer(const PatchFrame& frame, const RingKernel& ring, std::int32_t block_first, std::int32_t vertex,
                      std::int32_t first, std::int32_t rows, const float* centre_shares, float* out) {
  const std::int64_t width = ring.centre.outputs;
  for (std::int32_t row = 0; row < rows; ++row) {
    const std::int32_t edge = first + row;
    while (edge >= ring.starts[block_first + vertex + 1]) ++vertex;
    const std::int64_t j = ring.neighbours[edge];
    const double* from = frame.origins + 3 * static_cast<std::int64_t>(frame.free[block_first + vertex]);
    const double* to = frame.origins + 3 * j;
    const Lanes x = broadcast(static_cast<float>(to[0] - from[0]));
    const Lanes y = broadcast(static_cast<float>(to[1] - from[1]));
    const Lanes z = broadcast(static_cast<float>(to[2] - from[2]));
    const float* own = centre_shares + vertex * width;
    const float* other = ring.shares + j * width;
    for (std::int64_t c = 0; c < width; c += kLanes) {
      Lanes sum = add(load(own + c), load(other + c));
      sum = multiply_add(x, load(ring.offset + c), sum);
      sum = multiply_add(y, load(ring.offset + width + c), sum);
      sum = multiply_add(z, load(ring.offset + 2 * width + c), sum);
      store(out + row * width + c, tanh_of(sum));
    }
  }
}

void add_row(float* sum, const float* row, std::int64_t width) {
  for (std::int64_t c = 0; c < width; c += kLanes) store(sum + c, add(load(sum + c), load(row + c)));
}

// Adds up what a ring's neighbours do to the vertices [first, first + vertices).
void ring_sums(const PatchFrame& frame, const RingKernel& ring, std::int32_t first, std::int32_t vertices, const float* features,
               float* front, float* back, float* centre_shares, Rows joined) {
  dense<false>(ring.centre, features, frame.feature_count, centre_shares, ring.centre.outputs, vertices);
  const std::int64_t width = ring.hidden_count ? ring.hidden[ring.hidden_count - 1].outputs : ring.centre.outputs;
  for (std::int32_t v = 0; v < vertices; ++v) {
    float* row = joined.data + v * joined.stride;
    for (std::int64_t c = 0; c < width; c += kLanes) store(row + ring.column + c, broadcast(0.0f));
    row[ring.degree_column] = static_cast<float>(ring.starts[first + v + 1] - ring.starts[first + v]);
  }
  const std::int32_t edges_first = ring.starts[first], edges = ring.starts[first + vertices] - edges_first;
  const std::int32_t chunks = (edges + kBlockRows - 1) / kBlockRows;
  std::int32_t vertex = 0;
  for (std::int32_t chunk = 0; chunk < chunks; ++chunk) {
    const std::int32_t edge = edges_first + static_cast<std::int32_t>(std::int64_t{edges} * chunk / chunks);
    const std::int32_t end = edges_first + static_cast<std::int32_t>(std::int64_t{edges} * (chunk + 1) / chunks);
    while (edge >= ring.starts[first + vertex + 1]) ++vertex;
    first_edge_layer(frame, ring, first, vertex, edge, end - edge, centre_shares, front);
    // The layers take turns between the two buffers; an odd number of them ends in the other one.
    float* result = ring.hidden_count % 2 ? back : front;
    hidden_layers(ring.hidden, ring.hidden_count, front, ring.centre.outputs, front, back, {result, width}, end - edge);
    for (std::int32_t e = edge; e < end; ++e) {
      while (e >= ring.starts[first + vertex + 1]) ++vertex;
      add_row(joined.data + vertex * joined.stride + ring.column, result + (e - edge) * width, width);
    }
  }
}

}  // namespace

void neighbour_shares(const PatchFrame& frame, std::int32_t first, std::int32_t last) noexcept {
  for (std::int32_t block = first; block < last; block += kBlockRows) {
    const std::int32_t rows = last - block < kBlockRows ? last - block : kBlockRows;
    for (std::int32_t r = 0; r < frame.ring_count; ++r) {
      const RingKernel& ring = frame.rings[r];
      dense<false>(ring.neighbour, frame.features + static_cast<std::int64_t>(block) * frame.feature_count, frame.feature_count,
                   ring.shares + static_cast<std::int64_t>(block) * ring.neighbour.outputs, ring.neighbour.outputs, rows);
    }
  }
}

void predict_changes(const PatchFrame& frame, std::int32_t first, std::int32_t last, float* scratch) noexcept {
  const std::int64_t buffer = std::int64_t{kBlockRows} * frame.widest;
  float* front = scratch;
  float* back = front + buffer;
  float* centre_shares = back + buffer;
  const Rows joined{centre_shares + buffer, frame.joined_width};
  float* features = joined.data + std::int64_t{kBlockRows} * frame.joined_width;
  for (; first < last; first += kBlockRows) {
    const std::int32_t vertices = last - first < kBlockRows ? last - first : kBlockRows;
    for (std::int32_t v = 0; v < vertices; ++v) {
      const float* from = frame.features + static_cast<std::int64_t>(frame.free[first + v]) * frame.feature_count;
      for (std::int32_t k = 0; k < frame.feature_count; ++k) features[v * frame.feature_count + k] = from[k];
    }
    for (std::int32_t r = 0; r < frame.ring_count; ++r) {
      ring_sums(frame, frame.rings[r], first, vertices, features, front, back, centre_shares, joined);
    }
    hidden_layers(frame.inertia, frame.inertia_count, features, frame.feature_count, front, back, joined, vertices);
    const DenseKernel& output = frame.displacement[frame.displacement_count - 1];
    const std::int32_t hidden = frame.displacement_count - 1;
    const std::int64_t width = frame.displacement[hidden - 1].outputs;
    hidden_layers(frame.displacement, hidden, joined.data, joined.stride, front, back, {centre_shares, width}, vertices);
    dense<false>(output, centre_shares, width, front, output.outputs, vertices);
    for (std::int32_t v = 0; v < vertices; ++v) {
      for (int k = 0; k < 3; ++k) {
        frame.changes[3 * static_cast<std::int64_t>(first + v) + k] = front[v * static_cast<std::int64_t>(output.outputs) + k];
      }
    }
  }
}

void rational_tanh(const float* in, float* out, std::int64_t count) noexcept {
  std::int64_t i = 0;
  for (; i + kLanes <= count; i += kLanes) store(out + i, tanh_of(load(in + i)));
  if (i < count) {
    float rest[kLanes] = {};
    for (std::int64_t k = i; k < count; ++k) rest[k - i] = in[k];
    store(rest, tanh_of(load(rest)));
    for (std::int64_t k = i; k < count; ++k) out[k] = rest[k - i];
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
