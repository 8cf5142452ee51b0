// SPDX-License-Identifier: GPL-3.0-or-later
// Posing and inverse skinning: four bones a vertex of sixty. Bytes are what must cross memory once: tables in, positions in and
// out.
#include <benchmark/benchmark.h>

#include <cmath>

#include <Eigen/Geometry>

#include "followthrough/skinning/inverse_skinning.hpp"
#include "followthrough/skinning/skinning.hpp"

namespace {

using namespace followthrough;

struct Skin {
  static constexpr Eigen::Index bone_count = 60;
  static constexpr Eigen::Index places = 4;

  explicit Skin(Eigen::Index vertices)
      : rest_positions(vertices, 3),
        displacements(vertices, 3),
        indices(vertices, places),
        weights(vertices, places),
        matrices(bone_count, 16),
        rest_matrices(bone_count, 16) {
    for (Eigen::Index vertex = 0; vertex < vertices; ++vertex) {
      const double at = 0.01 * static_cast<double>(vertex);
      rest_positions.row(vertex) << std::cos(at), std::sin(at), at;
      displacements.row(vertex) << 0.1 * std::sin(3 * at), 0.05, 0.02 * std::cos(at);
      for (Eigen::Index place = 0; place < places; ++place) {
        indices(vertex, place) = static_cast<Index>((vertex * bone_count / vertices + place) % bone_count);
        weights(vertex, place) = 1.0 / static_cast<double>(1 + place);
      }
    }
    for (Eigen::Index bone = 0; bone < bone_count; ++bone) {
      const double at = 0.1 * static_cast<double>(bone);
      Eigen::Affine3d pose = Eigen::Translation3d(at, 0, -at) * Eigen::AngleAxisd(at, Eigen::Vector3d(1, 2, at).normalized());
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(matrices.row(bone).data()) = pose.matrix();
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(rest_matrices.row(bone).data()).setIdentity();
    }
  }

  BoneWeights bone_weights() const { return {indices, weights}; }
  PosedBones bones() const { return {matrices, rest_matrices}; }

  Positions rest_positions, displacements;
  IndexTable indices;
  Values weights;
  Matrices4 matrices, rest_matrices;
};

void count(benchmark::State& state, std::int64_t position_arrays) {
  const std::int64_t vertices = state.iterations() * state.range(0);
  const std::int64_t table = Skin::places * static_cast<std::int64_t>(sizeof(Index) + sizeof(double));
  state.SetItemsProcessed(vertices);
  state.SetBytesProcessed(vertices * (table + position_arrays * 3 * static_cast<std::int64_t>(sizeof(double))));
}

void pose(benchmark::State& state, Skinning skinning) {
  const Skin skin(state.range(0));
  for (auto _ : state) benchmark::DoNotOptimize(pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning));
  count(state, 2);
}

void inverse(benchmark::State& state, Skinning skinning) {
  const Skin skin(state.range(0));
  for (auto _ : state) {
    benchmark::DoNotOptimize(inverse_skin(skin.bone_weights(), skin.bones(), skin.displacements, skinning, 0.05));
  }
  count(state, 3);
}

}  // namespace

BENCHMARK_CAPTURE(pose, linear, Skinning::linear)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(pose, dual_quaternion, Skinning::dual_quaternion)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(inverse, linear, Skinning::linear)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(inverse, dual_quaternion, Skinning::dual_quaternion)->Arg(14'000)->Arg(100'000)->UseRealTime();
