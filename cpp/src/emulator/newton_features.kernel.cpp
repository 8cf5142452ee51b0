// SPDX-License-Identifier: GPL-3.0-or-later
// Lanes are the edges of a centre, or 16 centres; what they are told is turned into rows at the end.
#include "emulator/dense_rows.hpp"
#include "emulator/lane_algebra.hpp"
#include "emulator/newton_kernel.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

inline Real clamped(float limit, Real a) { return not_below(-limit, not_above(limit, a)); }

// R^T v, the matrix's nine numbers being the same in all lanes or not.
inline Triple turned_back(const Square& r, Triple v) { return v * r; }

inline Triple gather_triple(const float* from, const std::int32_t* index) {
  return {{gather(from, index)}, {gather(from + 1, index)}, {gather(from + 2, index)}};
}

inline Square gather_square(const float* from, const std::int32_t* index) {
  return {gather_triple(from, index), gather_triple(from + 3, index), gather_triple(from + 6, index)};
}

inline Square same_square(const float* m) {
  return {{real(m[0]), real(m[1]), real(m[2])}, {real(m[3]), real(m[4]), real(m[5])}, {real(m[6]), real(m[7]), real(m[8])}};
}

inline void store_six(float (*out)[kGroup], int lane, const Square& m, float scale) {
  const Real values[] = {m.x.x, m.y.y, m.z.z, m.x.y, m.x.z, m.y.z};
  for (int k = 0; k < 6; ++k) store(&out[k][lane], clamped(4.0f, values[k] * real(scale)));
}

}  // namespace

void edge_inputs(const NewtonPatchFrame& frame, std::int32_t first, std::int32_t last, float* out, std::int32_t stride) noexcept {
  float lanes[kNewtonEdgeStride][kGroup] = {};
  std::int32_t index[kGroup];
  for (std::int64_t centre = first; centre < last; ++centre) {
    const Square rotation = same_square(frame.rotations + 9 * centre);
    const Real scale = real(frame.inverse_size[centre]);
    const float* own = frame.records + centre * frame.record_size + frame.tail_column;
    const Triple here{real(own[0]), real(own[1]), real(own[2])};
    const std::int32_t end = frame.starts[centre + 1];
    for (std::int32_t edge = frame.starts[centre]; edge < end; edge += kGroup) {
      const std::int32_t count = end - edge < kGroup ? end - edge : kGroup;
      for (int lane = 0; lane < kGroup; ++lane) {
        index[lane] = frame.neighbours[edge + (lane < count ? lane : count - 1)] * frame.record_size;
      }
      for (int lane = 0; lane < count; lane += kLanes) {
        for (std::int32_t c = 0; c < frame.channel_count; ++c) {
          const Triple v = gather_triple(frame.records + frame.channel_columns[c], index + lane);
          store(&lanes[3 * c][lane], kGroup, turned_back(rotation, v) * scale);
        }
        float (*tail)[kGroup] = lanes + 3 * frame.channel_count;
        const float* from = frame.records + frame.tail_column;
        const Triple rest = load_triple(frame.rest_edges + edge + lane, frame.edge_stride);
        const Triple stretch = turned_back(rotation, gather_triple(from, index + lane) - here) - rest;
        store(&tail[0][lane], clamped(3.0f, stretch.x));
        store(&tail[1][lane], clamped(3.0f, stretch.y));
        store(&tail[2][lane], clamped(3.0f, stretch.z));
        store(&tail[3][lane], kGroup, rest);
        store(&tail[6][lane], gather(from + 4, index + lane));
        store(&tail[7][lane], gather(from + 3, index + lane));
      }
      float* rows = out + std::int64_t{edge - frame.starts[first]} * stride;
      for (std::int32_t c = 0; c < stride; c += kGroup) transpose_group(lanes[c], kGroup, rows + c, stride);
    }
  }
}

void centre_inputs(const NewtonPatchFrame& frame, std::int32_t group, float* out, std::int32_t stride) noexcept {
  float lanes[kNewtonCentreStride][kGroup] = {};
  std::int32_t record[kGroup], nine[kGroup], five[kGroup];
  for (int lane = 0; lane < kGroup; ++lane) {
    const std::int32_t centre = group * kGroup + lane;
    record[lane] = (centre < frame.free_count ? centre : frame.free_count - 1) * frame.record_size;
    nine[lane] = 9 * centre;
    five[lane] = 5 * centre;
  }
  for (int lane = 0; lane < kGroup; lane += kLanes) {
    const Square rotation = gather_square(frame.rotations, nine + lane);
    const Real scale = load_real(frame.inverse_size + std::int64_t{group} * kGroup + lane);
    for (std::int32_t c = 0; c < frame.channel_count; ++c) {
      const Triple v = gather_triple(frame.records + frame.channel_columns[c], record + lane);
      store(&lanes[3 * c][lane], kGroup, turned_back(rotation, v) * scale);
    }
    float (*tail)[kGroup] = lanes + 3 * frame.channel_count;
    for (int k = 0; k < 3; ++k) store(&tail[k][lane], gather(frame.own + k, five + lane));
    const Real one = real(1.0f), half = real(0.5f);
    const Square turned = transposed(rotation), stretch = turned * gather_square(frame.gradients, nine + lane);
    const Square strain{{stretch.x.x - one, half * (stretch.x.y + stretch.y.x), half * (stretch.x.z + stretch.z.x)},
                        {one, stretch.y.y - one, half * (stretch.y.z + stretch.z.y)},
                        {one, one, stretch.z.z - one}};
    store_six(tail + 3, lane, strain, 2.0f);
    const float* diagonal = frame.diagonal + std::int64_t{group} * 6 * kGroup + lane;
    Real d[6];
    for (int k = 0; k < 6; ++k) d[k] = load_real(diagonal + k * kGroup);
    Square stiffness = turned * Square{{d[0], d[3], d[4]}, {d[3], d[1], d[5]}, {d[4], d[5], d[2]}} * rotation;
    const Real mean = real(3.0f) / (stiffness.x.x + stiffness.y.y + stiffness.z.z);
    stiffness = {stiffness.x * mean, stiffness.y * mean, stiffness.z * mean};
    stiffness.x.x = stiffness.x.x - one;
    stiffness.y.y = stiffness.y.y - one;
    stiffness.z.z = stiffness.z.z - one;
    store_six(tail + 9, lane, stiffness, 1.0f);
    for (int k = 0; k < 2; ++k) store(&tail[15 + k][lane], gather(frame.own + 3 + k, five + lane));
  }
  for (std::int32_t c = 0; c < kNewtonCentreStride; c += kGroup) transpose_group(lanes[c], kGroup, out + c, stride);
}

void predict_steps(const NewtonPatchFrame& frame, const NewtonNetwork& network, std::int32_t first_group, std::int32_t last_group,
                   float* scratch) noexcept {
  const std::int64_t widest = network.widest, joined_width = network.joined_width;
  const std::int32_t edge_width = network.edge_first.outputs;
  const std::int32_t last_width = network.edge_count ? network.edges[network.edge_count - 1].outputs : edge_width;
  float* front = scratch;
  float* back = front + kBlockRows * widest;
  float* shares = back + kBlockRows * widest;
  float* joined = shares + std::int64_t{kGroup} * edge_width;
  float* inputs = joined + kGroup * joined_width;
  for (std::int32_t group = first_group; group < last_group; ++group) {
    const std::int32_t first = group * kGroup;
    const std::int32_t last = first + kGroup < frame.free_count ? first + kGroup : frame.free_count;
    float* centres = joined + last_width;
    centre_inputs(frame, group, centres, network.joined_width);
    dense<false>(network.centre, centres, joined_width, shares, edge_width, last - first);
    edge_inputs(frame, first, last, inputs, kNewtonEdgeStride);
    for (std::int32_t v = 0; v < last - first; ++v) {
      for (std::int32_t c = 0; c < last_width; c += kLanes) store(joined + v * joined_width + c, broadcast(0.0f));
    }
    const std::int32_t edge_start = frame.starts[first], edges = frame.starts[last] - edge_start;
    const std::int32_t chunks = (edges + kBlockRows - 1) / kBlockRows;
    std::int32_t filled = 0, summed = 0;  // centres of the edge that is next
    for (std::int32_t chunk = 0; chunk < chunks; ++chunk) {
      const auto begin = static_cast<std::int32_t>(std::int64_t{edges} * chunk / chunks);
      const auto end = static_cast<std::int32_t>(std::int64_t{edges} * (chunk + 1) / chunks);
      for (std::int32_t e = begin; e < end; ++e) {
        while (e + edge_start >= frame.starts[first + filled + 1]) ++filled;
        const float* from = shares + filled * std::int64_t{edge_width};
        float* to = front + (e - begin) * std::int64_t{edge_width};
        for (std::int32_t c = 0; c < edge_width; c += kLanes) store(to + c, load(from + c));
      }
      dense<true>(network.edge_first, inputs + begin * std::int64_t{kNewtonEdgeStride}, kNewtonEdgeStride, front, edge_width,
                  end - begin);
      float* result = network.edge_count % 2 ? back : front;
      hidden_layers(network.edges, network.edge_count, front, edge_width, front, back, {result, last_width}, end - begin);
      for (std::int32_t e = begin; e < end; ++e) {
        while (e + edge_start >= frame.starts[first + summed + 1]) ++summed;
        add_row(joined + summed * joined_width, result + (e - begin) * std::int64_t{last_width}, last_width);
      }
    }
    float* hidden = inputs;
    const std::int32_t width = network.instances[network.instance_count - 1].outputs;
    hidden_layers(network.instances, network.instance_count, joined, joined_width, front, back, {hidden, width}, last - first);
    dense<false>(network.out, hidden, width, front, network.out.outputs, last - first);
    for (std::int32_t v = 0; v < last - first; ++v) {
      const float* r = frame.rotations + 9 * std::int64_t{first + v};
      const float size = frame.size[first + v];
      float step[3];
      for (int k = 0; k < 3; ++k) {
        step[k] = front[v * std::int64_t{network.out.outputs} + k] + network.skip * centres[v * joined_width + k];
      }
      for (int k = 0; k < 3; ++k) {
        frame.steps[3 * std::int64_t{first + v} + k] =
            size * (r[3 * k] * step[0] + r[3 * k + 1] * step[1] + r[3 * k + 2] * step[2]);
      }
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
