// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes of a register are outputs of a layer, so a sum over neighbours never crosses lanes. A tile of rows by outputs is summed in
// registers over all inputs and goes through tanh before it is written; a block of rows goes through all layers before the next
// one.
#include "emulator/patch_kernel.hpp"

#include "emulator/patch_rows.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {

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
    gather_features(frame, first, vertices, features);
    for (std::int32_t r = 0; r < frame.ring_count; ++r) {
      ring_sums(frame, frame.rings[r], first, vertices, features, front, back, centre_shares, joined);
    }
    hidden_layers(frame.inertia, frame.inertia_count, features, frame.feature_count, front, back, joined, vertices);
    const std::int32_t hidden = frame.displacement_count - 1;
    const Rows last_hidden{centre_shares, frame.displacement[hidden - 1].outputs};
    hidden_layers(frame.displacement, hidden, joined.data, joined.stride, front, back, last_hidden, vertices);
    write_changes(frame, first, vertices, last_hidden, front);
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
