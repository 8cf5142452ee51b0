// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// What a patch network does to a block of vertices around its hidden layers, for kernel files only.
#pragma once

#include "emulator/dense_rows.hpp"
#include "emulator/patch_kernel.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// Features of a block's vertices, one row after the other.
void gather_features(const PatchFrame& frame, std::int32_t first, std::int32_t vertices, float* features) {
  for (std::int32_t v = 0; v < vertices; ++v) {
    const float* from = frame.features + static_cast<std::int64_t>(frame.free[first + v]) * frame.feature_count;
    for (std::int32_t k = 0; k < frame.feature_count; ++k) features[v * frame.feature_count + k] = from[k];
  }
}

// The displacement perceptron's last layer, on a block's rows of the one before it. `outputs` holds a row of that layer for each.
void write_changes(const PatchFrame& frame, std::int32_t first, std::int32_t vertices, Rows hidden, float* outputs) {
  const DenseKernel& layer = frame.displacement[frame.displacement_count - 1];
  dense<false>(layer, hidden.data, hidden.stride, outputs, layer.outputs, vertices);
  for (std::int32_t v = 0; v < vertices; ++v) {
    for (int k = 0; k < 3; ++k) {
      frame.changes[3 * static_cast<std::int64_t>(first + v) + k] = outputs[v * static_cast<std::int64_t>(layer.outputs) + k];
    }
  }
}

// The first layer's sum of an edge, a register of outputs at a time: i's share, j's share and what o_j - o_i adds.
struct EdgeSum {
  Lanes x, y, z;
  const float *own, *other, *offset;
  std::int64_t width;

  Lanes at(std::int64_t c) const {
    Lanes sum = add(load(own + c), load(other + c));
    sum = multiply_add(x, load(offset + c), sum);
    sum = multiply_add(y, load(offset + width + c), sum);
    return multiply_add(z, load(offset + 2 * width + c), sum);
  }
};

// Of an edge that leaves vertex `vertex` of the block that starts at the free vertex `block_first`.
inline EdgeSum edge_sum(const PatchFrame& frame, const RingKernel& ring, std::int32_t block_first, std::int32_t vertex,
                        std::int32_t edge, const float* centre_shares) {
  const std::int64_t width = ring.centre.outputs, j = ring.neighbours[edge];
  const double* from = frame.origins + 3 * static_cast<std::int64_t>(frame.free[block_first + vertex]);
  const double* to = frame.origins + 3 * j;
  return {broadcast(static_cast<float>(to[0] - from[0])),
          broadcast(static_cast<float>(to[1] - from[1])),
          broadcast(static_cast<float>(to[2] - from[2])),
          centre_shares + vertex * width,
          ring.shares + j * width,
          ring.offset,
          width};
}

// First layer of the edges [first, first + rows), `vertex` being the block's vertex that the first of them belongs to.
void first_edge_layer(const PatchFrame& frame, const RingKernel& ring, std::int32_t block_first, std::int32_t vertex,
                      std::int32_t first, std::int32_t rows, const float* centre_shares, float* out) {
  const std::int64_t width = ring.centre.outputs;
  for (std::int32_t row = 0; row < rows; ++row) {
    const std::int32_t edge = first + row;
    while (edge >= ring.starts[block_first + vertex + 1]) ++vertex;
    const EdgeSum sum = edge_sum(frame, ring, block_first, vertex, edge, centre_shares);
    for (std::int64_t c = 0; c < width; c += kLanes) store(out + row * width + c, tanh_of(sum.at(c)));
  }
}

// Shares of a block's vertices in a ring's first layer, and sums that are zero still. Returns how wide these are.
std::int64_t begin_ring(const PatchFrame& frame, const RingKernel& ring, std::int32_t first, std::int32_t vertices,
                        const float* features, float* centre_shares, Rows joined) {
  dense<false>(ring.centre, features, frame.feature_count, centre_shares, ring.centre.outputs, vertices);
  const std::int64_t width = ring.hidden_count ? ring.hidden[ring.hidden_count - 1].outputs : ring.centre.outputs;
  for (std::int32_t v = 0; v < vertices; ++v) {
    float* row = joined.data + v * joined.stride;
    for (std::int64_t c = 0; c < width; c += kLanes) store(row + ring.column + c, broadcast(0.0f));
    row[ring.degree_column] = static_cast<float>(ring.starts[first + v + 1] - ring.starts[first + v]);
  }
  return width;
}

// Adds up what a ring's neighbours do to the vertices [first, first + vertices).
void ring_sums(const PatchFrame& frame, const RingKernel& ring, std::int32_t first, std::int32_t vertices, const float* features,
               float* front, float* back, float* centre_shares, Rows joined) {
  const std::int64_t width = begin_ring(frame, ring, first, vertices, features, centre_shares, joined);
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
}  // namespace followthrough::FOLLOWTHROUGH_ISA
