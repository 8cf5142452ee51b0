// SPDX-License-Identifier: GPL-3.0-or-later
// Making a volume around a surface of 100,000 triangles, 25 cells along its longest side.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/surface_follower.hpp"
#include "followthrough/mesh/surface_transfer.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"

namespace {

using namespace followthrough;

struct Surface {
  Positions vertices;
  Triangles triangles;
};

// A bumpy rod bent to a horseshoe whose legs nearly touch; without its last rows of triangles it is open.
const Surface& horseshoe(bool open) {
  static const auto make = [](bool with_hole) {
    constexpr int kRings = 250, kSides = 200;
    Surface surface;
    surface.vertices.resize(kRings * kSides, 3);
    for (int r = 0; r < kRings; ++r) {
      const double turn = 1.95 * std::numbers::pi * r / (kRings - 1);
      const double taper = std::sqrt(std::max(0.0, 1 - std::pow(2.0 * r / (kRings - 1) - 1, 8)));
      for (int s = 0; s < kSides; ++s) {
        const double angle = 2 * std::numbers::pi * s / kSides;
        const double radius = 0.35 * taper * (1 + 0.05 * std::sin(9 * angle) * std::sin(20 * turn));
        const double reach = 1 + radius * std::cos(angle);
        surface.vertices.row(r * kSides + s) << reach * std::cos(turn), radius * std::sin(angle), reach * std::sin(turn);
      }
    }
    std::vector<Index> corners;
    for (int r = 0; r + 1 < kRings - (with_hole ? 40 : 0); ++r) {
      for (int s = 0; s < kSides; ++s) {
        const int a = r * kSides + s, b = r * kSides + (s + 1) % kSides;
        corners.insert(corners.end(), {a, b, b + kSides, a, b + kSides, a + kSides});
      }
    }
    surface.triangles = Eigen::Map<const Triangles>(corners.data(), static_cast<Eigen::Index>(corners.size() / 3), 3);
    return surface;
  };
  static const Surface closed = make(false), with_hole = make(true);
  return open ? with_hole : closed;
}

void voxelize(benchmark::State& state) {
  const Surface& surface = horseshoe(state.range(0) != 0);
  const VoxelSettings settings{25, 0, state.range(1) != 0};
  TetVolume volume;
  for (auto _ : state) volume = tetrahedralize(surface.vertices, surface.triangles, settings);
  state.counters["triangles"] = static_cast<double>(surface.triangles.rows());
  state.counters["cells"] = volume.cell_count;
}
BENCHMARK(voxelize)->ArgNames({"open", "split"})->ArgsProduct({{0, 1}, {0, 1}})->Unit(benchmark::kMillisecond);

// What one bake makes once: the column of bake_time.py, an open tube of 14,000 vertices, and its weights on 20 bones.
void make_volume(benchmark::State& state) {
  constexpr int kSides = 105, kRings = 133;
  Surface surface;
  surface.vertices.resize(kRings * kSides, 3);
  std::vector<Index> corners;
  for (int r = 0; r < kRings; ++r) {
    for (int s = 0; s < kSides; ++s) {
      const double angle = 2 * std::numbers::pi * s / kSides;
      surface.vertices.row(r * kSides + s) << 0.5 * std::cos(angle), 0.5 * std::sin(angle), 4.0 * r / (kRings - 1);
      const int a = r * kSides + s, b = r * kSides + (s + 1) % kSides;
      if (r + 1 < kRings) corners.insert(corners.end(), {a, b, b + kSides, a, b + kSides, a + kSides});
    }
  }
  surface.triangles = Eigen::Map<const Triangles>(corners.data(), static_cast<Eigen::Index>(corners.size() / 3), 3);
  const Values weights = Values::Random(surface.vertices.rows(), 20).cwiseAbs();
  for (auto _ : state) {
    const TetVolume volume = tetrahedralize(surface.vertices, surface.triangles, {25, 0, true});
    const SurfaceTransfer transfer(surface.vertices, surface.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                   volume.own_triangles);
    benchmark::DoNotOptimize(transfer(weights));
  }
}
BENCHMARK(make_volume)->Unit(benchmark::kMillisecond);

void embed_points(benchmark::State& state) {
  const Surface& surface = horseshoe(false);
  const TetVolume volume = tetrahedralize(surface.vertices, surface.triangles);
  for (auto _ : state) benchmark::DoNotOptimize(embed(surface.vertices, volume.vertices, volume.tets));
  state.SetItemsProcessed(state.iterations() * surface.vertices.rows());
}
BENCHMARK(embed_points)->Unit(benchmark::kMillisecond);

void interpolate_positions(benchmark::State& state) {
  const Surface& surface = horseshoe(false);
  const TetVolume volume = tetrahedralize(surface.vertices, surface.triangles);
  for (auto _ : state) {
    benchmark::DoNotOptimize(interpolate(volume.vertices, volume.tets, volume.embedding_tets, volume.embedding_weights));
  }
  state.SetItemsProcessed(state.iterations() * surface.vertices.rows());
}
BENCHMARK(interpolate_positions)->Unit(benchmark::kMicrosecond);

void transfer_weights(benchmark::State& state) {
  const Surface& surface = horseshoe(false);
  const TetVolume volume = tetrahedralize(surface.vertices, surface.triangles);
  const Values values = Values::Random(surface.vertices.rows(), 20);
  for (auto _ : state) {
    const SurfaceTransfer transfer(surface.vertices, surface.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                   volume.own_triangles);
    benchmark::DoNotOptimize(transfer(values));
  }
}
BENCHMARK(transfer_weights)->Unit(benchmark::kMillisecond);

void follow_surface(benchmark::State& state) {
  const Surface& surface = horseshoe(false);
  const TetVolume volume = tetrahedralize(surface.vertices, surface.triangles);
  const SurfaceFollower follower(surface.vertices, surface.triangles, volume.vertices, volume.tets, volume.own_offsets,
                                 volume.own_triangles);
  for (auto _ : state) benchmark::DoNotOptimize(follower(surface.vertices));
  state.SetItemsProcessed(state.iterations() * volume.vertices.rows());
}
BENCHMARK(follow_surface)->Unit(benchmark::kMillisecond);

}  // namespace
