// SPDX-License-Identifier: GPL-3.0-or-later
// Posing and inverse skinning: four bones a vertex of sixty. Bytes are what must cross memory once: tables in, positions in and
// out.
#include <benchmark/benchmark.h>
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>
#include <utility>
#include <vector>

#include <Eigen/Geometry>

#include "followthrough/mesh/tetrahedralize.hpp"
#include "followthrough/motion/rigged_motion.hpp"
#include "followthrough/skinning/inverse_skinning.hpp"
#include "followthrough/skinning/skinning.hpp"
#include "followthrough/springs/springs.hpp"

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

// A whole frame of a character: a column of about so many vertices on 20 bones that swing, one tenth of it pinned. Reference,
// springs, embedding and inverse skinning, with as many threads as the frames of a bake take: one.
void rigged_motion(benchmark::State& state, Skinning skinning) {
  constexpr Eigen::Index bone_count = 20;
  const auto sides = static_cast<Eigen::Index>(std::lround(std::sqrt(static_cast<double>(state.range(0)) * std::numbers::pi / 4)));
  const Eigen::Index rings = state.range(0) / sides;
  Positions skin(rings * sides, 3);
  Triangles triangles(2 * sides * (rings - 1), 3);
  for (Eigen::Index ring = 0, face = 0; ring < rings; ++ring) {
    for (Eigen::Index side = 0; side < sides; ++side) {
      const double angle = 2 * std::numbers::pi * static_cast<double>(side) / static_cast<double>(sides);
      skin.row(ring * sides + side) << 0.5 * std::cos(angle), 0.5 * std::sin(angle),
          4.0 * static_cast<double>(ring) / static_cast<double>(rings - 1);
      if (ring + 1 == rings) continue;
      const auto a = static_cast<Index>(ring * sides + side), b = static_cast<Index>(ring * sides + (side + 1) % sides);
      const auto up = static_cast<Index>(sides);
      triangles.row(face++) << a, b, b + up;
      triangles.row(face++) << a, b + up, a + up;
    }
  }
  const auto weights_of = [](const Positions& points) {
    std::pair<IndexTable, Values> result(IndexTable(points.rows(), 2), Values(points.rows(), 2));
    for (Eigen::Index v = 0; v < points.rows(); ++v) {
      const double place = std::clamp(points(v, 2) * bone_count / 4.0 - 0.5, 0.0, bone_count - 1.0);
      const auto lower = std::min(static_cast<Index>(place), static_cast<Index>(bone_count - 2));
      result.first.row(v) << lower, lower + 1;
      result.second.row(v) << 1 - (place - lower), place - lower;
    }
    return result;
  };
  const TetVolume volume = tetrahedralize(skin, triangles, {25, 0, true});
  RiggedCharacter character;
  character.volume_rest_positions = volume.vertices;
  character.tets = volume.tets;
  character.embedding = {volume.embedding_tets, volume.embedding_weights};
  std::tie(character.volume_bones, character.volume_weights) = weights_of(volume.vertices);
  std::tie(character.surface_bones, character.surface_weights) = weights_of(skin);
  character.bone_rest_matrices = Matrices4(bone_count, 16);
  character.skinning = skinning;
  std::vector<RigPose> poses;
  for (int frame = 0; frame < 8; ++frame) {
    RigPose pose{Matrices4(bone_count, 16), Eigen::Matrix4d::Identity(), Eigen::Matrix4d::Identity()};
    for (Eigen::Index bone = 0; bone < bone_count; ++bone) {
      const double angle = 0.03 * static_cast<double>(bone) * std::sin(2 * std::numbers::pi * frame / 8.0);
      const Eigen::Affine3d turn(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitX()));
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(pose.bone_matrices.row(bone).data()) = turn.matrix();
      Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(character.bone_rest_matrices.row(bone).data()).setIdentity();
    }
    poses.push_back(pose);
  }
  const Eigen::Index count = volume.vertices.rows();
  Mask pinned(count);
  for (Eigen::Index v = 0; v < count; ++v) pinned[v] = volume.vertices(v, 2) < 0.4;
  Springs springs(Vector::Constant(count, 1000.0), Vector::Constant(count, 15.0), 1.0 / 24.0, pinned);
  RiggedMotion motion(character, springs);
  const int usual_threads = omp_get_max_threads();
  omp_set_num_threads(1);
  motion.reset(poses[0]);
  std::size_t frame = 0;
  for (auto _ : state) {
    frame = (frame + 1) % poses.size();
    benchmark::DoNotOptimize(motion.step(poses[frame], &poses[(frame + 1) % poses.size()]));
  }
  omp_set_num_threads(usual_threads);
  state.SetItemsProcessed(state.iterations() * skin.rows());
}

}  // namespace

BENCHMARK_CAPTURE(pose, linear, Skinning::linear)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(pose, dual_quaternion, Skinning::dual_quaternion)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(inverse, linear, Skinning::linear)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(inverse, dual_quaternion, Skinning::dual_quaternion)->Arg(14'000)->Arg(100'000)->UseRealTime();
BENCHMARK_CAPTURE(rigged_motion, linear, Skinning::linear)->Arg(14'000)->UseRealTime()->Unit(benchmark::kMicrosecond);
BENCHMARK_CAPTURE(rigged_motion, dual_quaternion, Skinning::dual_quaternion)
    ->Arg(14'000)
    ->UseRealTime()
    ->Unit(benchmark::kMicrosecond);
