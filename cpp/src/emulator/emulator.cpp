// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/emulator.hpp"

#include <omp.h>

#include <Eigen/LU>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string>
#include <vector>

#include "bfloat16_unit.hpp"
#include "emulator/packed_network.hpp"
#include "emulator/patch_kernel.hpp"
#include "emulator/patches.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

// What a core does at least, multiply-adds a nanosecond.
constexpr double slowest_rate = 20.0, slowest_pair_rate = 40.0, slowest_tile_rate = 200.0;

struct Kernels {
  decltype(&baseline::neighbour_shares) neighbour_shares;
  decltype(&baseline::predict_changes) predict_changes;
  std::int32_t block_rows = kBlockRows;
  double rate = slowest_rate;
};

Kernels kernels(Precision precision) {
#ifdef FOLLOWTHROUGH_HAS_amx
  if (precision == Precision::bfloat16 && bfloat16_unit() == Bfloat16Unit::tiles) {
    return {avx512::neighbour_shares, amx::predict_changes, kTileBlockRows, slowest_tile_rate};
  }
#endif
#ifdef FOLLOWTHROUGH_HAS_avx512_bf16
  if (precision == Precision::bfloat16) {
    return {avx512::neighbour_shares, avx512_bf16::predict_changes, kTileBlockRows, slowest_pair_rate};
  }
#else
  (void)precision;
#endif
  return {FOLLOWTHROUGH_KERNEL(neighbour_shares), FOLLOWTHROUGH_KERNEL(predict_changes)};
}

void require_positive(const char* name, const Vector& values, Eigen::Index count) {
  require_rows(name, values.size(), count);
  for (Eigen::Index v = 0; v < count; ++v) {
    if (!(std::isfinite(values[v]) && values[v] > 0.0)) {
      throw InvalidInput(name, "found " + std::to_string(values[v]) + " at vertex " + std::to_string(v) +
                                   ", expected finite numbers, more than 0");
    }
  }
}

void require_positive(const char* name, double value, const char* unit) {
  if (!(std::isfinite(value) && value > 0.0)) {
    throw InvalidInput(name, "found " + std::to_string(value) + ", expected a positive number of " + unit);
  }
}

Vector tet_volumes(const EmulatedBody& body) {
  Vector volumes(body.tets.rows());
  for (Eigen::Index t = 0; t < volumes.size(); ++t) {
    Eigen::Matrix3d edges;
    for (int k = 0; k < 3; ++k) {
      edges.row(k) = body.rest_positions.row(body.tets(t, k + 1)) - body.rest_positions.row(body.tets(t, 0));
    }
    volumes[t] = std::abs(edges.determinant()) / 6.0;
  }
  return volumes;
}

// Edge of a cube that six tets with the median volume fill: a pose that squashes some of the cubes does not change it.
double cube_edge(Vector volumes) {
  if (volumes.size() == 0) return 0.0;
  std::nth_element(volumes.begin(), volumes.begin() + volumes.size() / 2, volumes.end());
  return std::cbrt(6.0 * volumes[volumes.size() / 2]);
}

}  // namespace

struct Emulator::Parts {
  Parts(const EmulatedBody& body, const PatchNetwork& network, const NetworkUnits& units, Precision precision);

  void gather_features(const ConstPositions& reference, Eigen::Index first, Eigen::Index last);
  void move(Eigen::Index first, Eigen::Index last);
  void predict(const ConstPositions& reference);

  Eigen::Index count;
  Positions rest;
  std::vector<bool> constrained;
  std::vector<Index> constrained_vertices;
  double edge_length, scale;  // scale: the network's metres a metre of the scene
  Eigen::RowVector3d fall;    // h^2 g / 2, m: how far a frame that falls gets in one step
  Vector stiffness;
  PackedNetwork network;
  Patches patches;
  PatchFrame frame{};
  std::vector<float> features;
  std::vector<double> origins;
  std::vector<AlignedFloats> shares;
  std::vector<float> changes;
  std::vector<AlignedFloats> scratch;  // one a thread
  double cost = 0;                     // multiply-adds a step
  Positions now, before, before_that;  // u(t), u(t-1), u(t-2)
  Positions reference_now, reference_before;
  std::int64_t frames = -1;  // since the reset; -1: never reset
};

Emulator::Parts::Parts(const EmulatedBody& body, const PatchNetwork& weights, const NetworkUnits& units, Precision precision)
    : count(body.rest_positions.rows()), rest(body.rest_positions), network((require_network(weights), weights), precision) {
  if (precision == Precision::bfloat16) require_bfloat16_unit();
  require_finite("gravity", body.gravity.transpose());
  require_finite("rest_positions", rest);
  require_indices("tets", body.tets, count);
  require_rows("constrained", body.constrained.size(), count);
  require_positive("youngs_modulus", body.youngs_modulus, count);
  require_positive("density", body.density, count);
  require_positive("dt", body.dt, "seconds");
  require_positive("edge_length of the network", units.edge_length, "metres");
  require_positive("dt of the network", units.dt, "seconds");
  require_positive("density of the network", units.density, "kg/m3");
  const Vector volumes = tet_volumes(body);
  if (!(std::isfinite(body.edge_length) && body.edge_length >= 0.0)) {
    throw InvalidInput("edge_length", "found " + std::to_string(body.edge_length) + ", expected a positive number of metres");
  }
  edge_length = body.edge_length > 0.0 ? body.edge_length : cube_edge(volumes);
  if (!(edge_length > 0.0)) {
    throw InvalidInput("tets", "found none with a volume, expected a mesh of tets");
  }
  scale = units.edge_length / edge_length;
  fall = 0.5 * body.dt * body.dt * body.gravity.transpose();

  // Masses scale by one factor, so that the scene's mean density becomes the network's: backward Euler knows only ratios of mass.
  Vector mass = Vector::Zero(count);
  double total_mass = 0.0;
  for (Eigen::Index t = 0; t < volumes.size(); ++t) {
    double density = 0.0;
    for (int k = 0; k < 4; ++k) density += body.density[body.tets(t, k)] / 4.0;
    total_mass += density * volumes[t];
    for (int k = 0; k < 4; ++k) mass[body.tets(t, k)] += density * volumes[t] / 4.0;
  }
  const double lightness = units.density * volumes.sum() / total_mass;
  const double ratio = scale * body.dt / units.dt;
  const double modulus_scale = lightness * ratio * ratio * 1e-6;  // Pa -> MPa that mean the same s
  const double mass_scale = lightness * scale * scale * scale;
  const double frames_per_edge = body.dt / edge_length;
  stiffness = (body.youngs_modulus.array() / body.density.array() * (frames_per_edge * frames_per_edge)).matrix();

  constrained.assign(body.constrained.begin(), body.constrained.end());
  for (Eigen::Index v = 0; v < count; ++v) {
    if (constrained[static_cast<std::size_t>(v)]) {
      constrained_vertices.push_back(static_cast<Index>(v));
    } else if (!(mass[v] > 0.0)) {
      throw InvalidInput("tets", "found no volume around the free vertex " + std::to_string(v) + ", expected it to have mass");
    }
  }

  patches = find_patches(rest, body.tets, body.constrained, static_cast<int>(network.rings().size()));
  const std::size_t rows = patches.vertices.size(), feature_count = static_cast<std::size_t>(network.feature_count());
  features.assign(rows * feature_count, 0.0f);
  origins.assign(3 * rows, 0.0);
  changes.assign(3 * patches.free.size(), 0.0f);
  for (std::size_t row = 0; row < rows; ++row) {
    const Index v = patches.vertices[row];
    const double k = body.youngs_modulus[v] * modulus_scale, m = mass[v] * mass_scale;
    float* material = features.data() + row * feature_count + network.motion_count();
    material[0] = static_cast<float>(k);
    material[1] = static_cast<float>(m);
    material[2] = m > 0.0 ? static_cast<float>(k / m) : 0.0f;  // without mass: a constrained neighbour's, which nobody reads
    material[3] = constrained[static_cast<std::size_t>(v)] ? 1.0f : 0.0f;
  }
  cost = network.vertex_cost() * static_cast<double>(patches.free.size());
  for (std::size_t r = 0; r < network.rings().size(); ++r) {
    RingKernel& ring = network.rings()[r];
    shares.emplace_back(rows * static_cast<std::size_t>(ring.centre.outputs));
    ring.shares = shares.back().data();
    ring.starts = patches.rings[r].starts.data();
    ring.neighbours = patches.rings[r].neighbours.data();
    cost += network.edge_cost(r) * static_cast<double>(patches.rings[r].neighbours.size());
  }
  frame = network.frame();
  frame.features = features.data();
  frame.origins = origins.data();
  frame.free = patches.free.data();
  frame.changes = changes.data();
}

// Motion of the vertices in the rows [first, last) relative to their own origins.
void Emulator::Parts::gather_features(const ConstPositions& reference, Eigen::Index first, Eigen::Index last) {
  const bool sees_reference = network.sees_reference();
  for (Eigen::Index row = first; row < last; ++row) {
    const Eigen::Index v = patches.vertices[static_cast<std::size_t>(row)];
    // Without reference motion, a constrained vertex is where it will be at the frame's end.
    const bool ahead = !sees_reference && constrained[static_cast<std::size_t>(v)];
    float* own = features.data() + static_cast<std::size_t>(row) * static_cast<std::size_t>(network.feature_count());
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      // Seen from a frame that falls.
      const double next = reference(v, axis) - fall[axis], here = reference_now(v, axis),
                   past = reference_before(v, axis) - fall[axis];
      const double u0 = ahead ? next : now(v, axis), u1 = ahead ? here : before(v, axis) - fall[axis];
      const double u2 = ahead ? past : before_that(v, axis) - 4.0 * fall[axis];
      const double origin = sees_reference ? here : u0;
      origins[static_cast<std::size_t>(3 * row + axis)] = scale * (origin - rest(v, axis));
      if (sees_reference) {
        own[axis] = static_cast<float>(scale * (u0 - origin));
        own[3 + axis] = static_cast<float>(scale * (u1 - origin));
        own[6 + axis] = static_cast<float>(scale * (u2 - origin));
        own[9 + axis] = static_cast<float>(scale * (next - origin));
        own[12 + axis] = static_cast<float>(scale * (past - origin));
      } else {
        own[axis] = static_cast<float>(scale * (u1 - origin));
        own[3 + axis] = static_cast<float>(scale * (u2 - origin));
      }
    }
  }
}

// Where the free vertices [first, last) go; the oldest frame's memory takes them.
void Emulator::Parts::move(Eigen::Index first, Eigen::Index last) {
  for (auto i = static_cast<std::size_t>(first); i < static_cast<std::size_t>(last); ++i) {
    const Index v = patches.vertices[static_cast<std::size_t>(patches.free[i])];
    for (Eigen::Index axis = 0; axis < 3; ++axis) {
      before_that(v, axis) =
          now(v, axis) + static_cast<double>(changes[3 * i + static_cast<std::size_t>(axis)]) / scale + fall[axis];
    }
  }
}

// One parallel region for all, as waking threads takes as long as some of its loops.
void Emulator::Parts::predict(const ConstPositions& reference) {
  const Kernels kernel = kernels(network.precision());
  const auto blocks_of = [&](Eigen::Index all) { return (all + kernel.block_rows - 1) / kernel.block_rows; };
  const auto rows = static_cast<Eigen::Index>(patches.vertices.size()), free = static_cast<Eigen::Index>(patches.free.size());
  const Eigen::Index row_blocks = blocks_of(rows), free_blocks = blocks_of(free);
  const double block_cost = free_blocks ? cost / static_cast<double>(free_blocks) / kernel.rate : 0.0;
  const int threads = std::min(worthwhile_threads(free_blocks, block_cost), static_cast<int>(scratch.size()));
#pragma omp parallel num_threads(threads)
  {
#pragma omp for schedule(static)
    for (Eigen::Index block = 0; block < row_blocks; ++block) {
      const Eigen::Index first = block * kernel.block_rows, last = std::min(first + kernel.block_rows, rows);
      gather_features(reference, first, last);
      kernel.neighbour_shares(frame, static_cast<std::int32_t>(first), static_cast<std::int32_t>(last));
    }
#pragma omp for schedule(dynamic, 1)
    for (Eigen::Index block = 0; block < free_blocks; ++block) {
      const Eigen::Index first = block * kernel.block_rows, last = std::min(first + kernel.block_rows, free);
      kernel.predict_changes(frame, static_cast<std::int32_t>(first), static_cast<std::int32_t>(last),
                             scratch[static_cast<std::size_t>(omp_get_thread_num())].data());
      move(first, last);
    }
  }
}

Emulator::Emulator(const EmulatedBody& body, const PatchNetwork& network, const NetworkUnits& units, Precision precision)
    : parts_(std::make_unique<Parts>(body, network, units, precision)) {}
Emulator::~Emulator() = default;
Emulator::Emulator(Emulator&&) noexcept = default;
Emulator& Emulator::operator=(Emulator&&) noexcept = default;

Eigen::Index Emulator::vertex_count() const { return parts_->count; }
Eigen::Index Emulator::free_vertex_count() const { return static_cast<Eigen::Index>(parts_->patches.free.size()); }
double Emulator::multiply_adds() const { return parts_->cost; }
double Emulator::edge_length() const { return parts_->edge_length; }
const Vector& Emulator::stiffness() const { return parts_->stiffness; }

Eigen::Index Emulator::edge_count() const {
  std::size_t count = 0;
  for (const Ring& ring : parts_->patches.rings) count += ring.neighbours.size();
  return static_cast<Eigen::Index>(count);
}

void Emulator::reset(ConstPositions reference) {
  Parts& p = *parts_;
  require_rows("reference", reference.rows(), p.count);
  require_finite("reference", reference);
  p.now = reference;
  for (Positions* array : {&p.before, &p.before_that, &p.reference_now, &p.reference_before}) *array = p.now;
  const auto threads = static_cast<std::size_t>(omp_get_max_threads());
  while (p.scratch.size() < threads) p.scratch.emplace_back(p.network.scratch_size());
  p.frames = 0;
}

const Positions& Emulator::step(ConstPositions reference, const Positions* /*next_reference*/) {
  Parts& p = *parts_;
  if (p.frames < 0) {
    throw InvalidInput("reference", "found a step before the first reset, expected reset to be called with the first frame");
  }
  require_rows("reference", reference.rows(), p.count);
  require_finite("reference", reference);
  p.predict(reference);
  for (const Index v : p.constrained_vertices) p.before_that.row(v) = reference.row(v);
  p.reference_before = reference;
  p.reference_before.swap(p.reference_now);
  p.before_that.swap(p.before);
  p.before.swap(p.now);
  ++p.frames;
  return p.now;
}

SolverState Emulator::state() const {
  const Parts& p = *parts_;
  return {{p.now, p.before, p.before_that, p.reference_now, p.reference_before}, {p.frames}};
}

void Emulator::restore(const SolverState& state) {
  Parts& p = *parts_;
  if (state.arrays.size() != 5 || state.counters.size() != 1 || state.counters[0] < -1) {
    throw InvalidInput("state", "found " + std::to_string(state.arrays.size()) + " arrays and " +
                                    std::to_string(state.counters.size()) +
                                    " counters, expected 5 and 1 as Emulator.state gives them");
  }
  const Eigen::Index rows = state.counters[0] < 0 ? 0 : p.count;
  for (const Positions& array : state.arrays) {
    require_rows("state", array.rows(), rows);
    require_finite("state", array);
  }
  if (rows) {
    reset(state.arrays[0]);
  }
  Positions* arrays[] = {&p.now, &p.before, &p.before_that, &p.reference_now, &p.reference_before};
  for (std::size_t k = 0; k < state.arrays.size(); ++k) *arrays[k] = state.arrays[k];
  p.frames = state.counters[0];
}

}  // namespace followthrough
