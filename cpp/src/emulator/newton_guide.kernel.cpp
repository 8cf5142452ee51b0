// SPDX-License-Identifier: GPL-3.0-or-later
// Rows lie side by side in a register: sixteen of them go through a guide's whole perceptron in the first-level cache.
#include "emulator/dense_rows.hpp"
#include "emulator/newton_kernel.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// Signed roots of the vectors' products, relative to the sum of their squares: pairs (0,0) (0,1) ... (1,1) ..., then the scalars.
inline void guide_inputs(const GuideInputs& in, std::int64_t first, float* out) {
  const Lanes zero = broadcast(0.0f), floor = broadcast(1e-9f);
  for (int lane = 0; lane < kNewtonGroup; lane += kLanes) {
    const Lanes share = load(in.inverse_squares + first + lane);
    float* to = out + lane;
    for (std::int32_t a = 0; a < in.vector_count; ++a) {
      const float* left = in.vectors[a] + first + lane;
      const Lanes x = load(left), y = load(left + in.padded), z = load(left + 2 * std::int64_t{in.padded});
      for (std::int32_t b = a; b < in.vector_count; ++b, to += kNewtonGroup) {
        const float* right = in.vectors[b] + first + lane;
        const Lanes product = multiply_add(
            x, load(right), multiply_add(y, load(right + in.padded), multiply(z, load(right + 2 * std::int64_t{in.padded}))));
        const Lanes size = larger(product, subtract(zero, product));
        const Lanes root = square_root(multiply_add(size, share, floor));
        store(to, select(less(product, zero), subtract(zero, root), select(less(zero, product), root, zero)));
      }
    }
    for (std::int32_t k = 0; k < in.scalar_count; ++k, to += kNewtonGroup) {
      store(to, load(in.scalars[k] + first + lane));
    }
  }
}

template <int kOutputs, bool kTanh>
inline void outputs(const GuideLayer& layer, std::int32_t first, const float* in, float* out) {
  for (int lane = 0; lane < kNewtonGroup; lane += kLanes) {
    Lanes sums[kOutputs];
    FOLLOWTHROUGH_UNROLL
    for (int o = 0; o < kOutputs; ++o) sums[o] = broadcast(layer.bias[first + o]);
    const float* weight = layer.weight + std::int64_t{first} * layer.inputs;
    for (std::int32_t k = 0; k < layer.inputs; ++k) {
      const Lanes x = load(in + k * kNewtonGroup + lane);
      FOLLOWTHROUGH_UNROLL
      for (int o = 0; o < kOutputs; ++o) sums[o] = multiply_add(broadcast(weight[o * std::int64_t{layer.inputs} + k]), x, sums[o]);
    }
    FOLLOWTHROUGH_UNROLL
    for (int o = 0; o < kOutputs; ++o) store(out + (first + o) * kNewtonGroup + lane, kTanh ? tanh_of(sums[o]) : sums[o]);
  }
}

template <bool kTanh>
inline void dense(const GuideLayer& layer, const float* in, float* out) {
  constexpr int at_once = kLanes == 16 ? 8 : 4;
  std::int32_t first = 0;
  for (; first + at_once <= layer.outputs; first += at_once) outputs<at_once, kTanh>(layer, first, in, out);
  for (; first < layer.outputs; ++first) outputs<1, kTanh>(layer, first, in, out);
}

}  // namespace

void neighbour_means(const float* records, const std::int32_t* starts, const std::int32_t* neighbours, std::int32_t rows,
                     std::int32_t padded, std::int32_t first_group, std::int32_t last_group, float* means) noexcept {
  float lanes[kNewtonGroup][kNewtonRecord] = {};
  for (std::int64_t group = first_group; group < last_group; ++group) {
    for (int lane = 0; lane < kNewtonGroup; ++lane) {
      const std::int64_t row = group * kNewtonGroup + lane;
      Lanes sums[kNewtonRecord / kLanes];
      for (int k = 0; k < kNewtonRecord / kLanes; ++k) sums[k] = broadcast(0.0f);
      if (row < rows) {
        const float share = 1.0f / static_cast<float>(starts[row + 1] - starts[row]);
        for (std::int32_t e = starts[row]; e < starts[row + 1]; ++e) {
          const float* record = records + std::int64_t{neighbours[e]} * kNewtonRecord;
          for (int k = 0; k < kNewtonRecord / kLanes; ++k) sums[k] = add(sums[k], load(record + k * kLanes));
        }
        const float* own = records + row * kNewtonRecord;
        for (int k = 0; k < kNewtonRecord / kLanes; ++k) {
          sums[k] = subtract(multiply(sums[k], broadcast(share)), load(own + k * kLanes));
        }
      }
      for (int k = 0; k < kNewtonRecord / kLanes; ++k) store(lanes[lane] + k * kLanes, sums[k]);
    }
    transpose_group(lanes[0], kNewtonRecord, means + group * kNewtonGroup, padded);
  }
}

void guide_rows(const GuideInputs& in, const GuideKernel& guide, std::int32_t first_group, std::int32_t last_group,
                float* scratch) noexcept {
  float *now = scratch, *next = scratch + std::int64_t{guide.widest} * kNewtonGroup;
  for (std::int64_t group = first_group; group < last_group; ++group) {
    const std::int64_t first = group * kNewtonGroup;
    guide_inputs(in, first, now);
    for (std::int32_t k = 0; k < guide.layer_count; ++k) {
      if (k + 1 < guide.layer_count) {
        dense<true>(guide.layers[k], now, next);
      } else {
        dense<false>(guide.layers[k], now, next);
      }
      float* other = now;
      now = next;
      next = other;
    }
    for (int axis = 0; axis < 3; ++axis) {
      for (int lane = 0; lane < kNewtonGroup; lane += kLanes) {
        Lanes sum = broadcast(0.0f);
        for (std::int32_t v = 0; v < in.vector_count; ++v) {
          sum = multiply_add(load(now + v * kNewtonGroup + lane),
                             load(in.vectors[v] + axis * std::int64_t{in.padded} + first + lane), sum);
        }
        store(in.steps + axis * std::int64_t{in.padded} + first + lane, sum);
      }
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
