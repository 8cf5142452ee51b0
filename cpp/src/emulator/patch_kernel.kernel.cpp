// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes of a register are outputs of a layer, so a sum over neighbours never crosses lanes. A tile of rows by outputs is summed in
// registers over all inputs and goes through tanh before it is written; a block of rows goes through all layers before the next
// one.
#include "emulator/patch_kernel.hpp"

#include "emulator/dense_rows.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

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
