// SPDX-License-Identifier: GPL-3.0-or-later
#include <doctest/doctest.h>
#include <omp.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <thread>
#include <tuple>
#include <utility>
#include <vector>

#include <Eigen/LU>

#include "followthrough/errors.hpp"
#include "followthrough/mesh/embedding.hpp"
#include "followthrough/mesh/tetrahedralize.hpp"
#include "followthrough/motion/rigged_motion.hpp"
#include "followthrough/skinning/inverse_skinning.hpp"
#include "followthrough/springs/springs.hpp"
#include "instruction_set.hpp"

using namespace followthrough;

namespace {

constexpr double dt = 1.0 / 24.0;

/// A box of 1 x 1 x 3 on two bones, the lower half on the first; the second swings.
struct Box {
  Positions vertices{8, 3};
  TetVolume volume;
  RiggedCharacter character;

  Box() {
    vertices << 0, 0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 0, 0, 0, 3, 1, 0, 3, 1, 1, 3, 0, 1, 3;
    Triangles triangles(12, 3);
    triangles << 0, 2, 1, 0, 3, 2, 4, 5, 6, 4, 6, 7, 0, 1, 5, 0, 5, 4, 1, 2, 6, 1, 6, 5, 2, 3, 7, 2, 7, 6, 3, 0, 4, 3, 4, 7;
    VoxelSettings settings;
    settings.cells = 9;
    volume = tetrahedralize(vertices, triangles, settings);
    character.volume_rest_positions = volume.vertices;
    character.tets = volume.tets;
    character.embedding = {volume.embedding_tets, volume.embedding_weights};
    std::tie(character.volume_bones, character.volume_weights) = weights_of(volume.vertices);
    std::tie(character.surface_bones, character.surface_weights) = weights_of(vertices);
  }

  /// Another skin: points all over the box, so many that threads share the work.
  void take_skin_of(Eigen::Index points) {
    vertices =
        (Positions::Random(points, 3) * Eigen::Vector3d(0.5, 0.5, 1.5).asDiagonal()).rowwise() + Eigen::RowVector3d(0.5, 0.5, 1.5);
    character.embedding = embed(vertices, volume.vertices, volume.tets);
    std::tie(character.surface_bones, character.surface_weights) = weights_of(vertices);
  }

  static std::pair<IndexTable, Values> weights_of(const Positions& points) {
    IndexTable bones(points.rows(), 2);
    Values weights(points.rows(), 2);
    for (Eigen::Index v = 0; v < points.rows(); ++v) {
      const double upper = std::min(std::max(points(v, 2) - 1.0, 0.0), 1.0);
      bones.row(v) << 0, 1;
      weights.row(v) << 1.0 - upper, upper;
    }
    return {bones, weights};
  }

  Springs springs() const {
    const Eigen::Index count = volume.vertices.rows();
    Mask pinned = Mask::Constant(count, false);
    for (Eigen::Index v = 0; v < count; ++v) pinned[v] = volume.vertices(v, 2) < 0.5;
    return {Vector::Constant(count, 200.0), Vector::Constant(count, 5.0), dt, pinned};
  }
};

RigPose pose_at(int frame) {
  RigPose pose{Matrices4(2, 16), Eigen::Matrix4d::Identity(), Eigen::Matrix4d::Identity()};
  const double angle = 0.6 * std::sin(0.7 * frame);
  Eigen::Matrix<double, 4, 4, Eigen::RowMajor> bone = Eigen::Matrix4d::Identity();
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(pose.bone_matrices.row(0).data()) = bone;
  bone(1, 1) = bone(2, 2) = std::cos(angle);
  bone(2, 1) = std::sin(angle);
  bone(1, 2) = -std::sin(angle);
  bone(0, 3) = 0.3 * frame * frame / 100.0;
  Eigen::Map<Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(pose.bone_matrices.row(1).data()) = bone;
  pose.world(0, 0) = 2.0;  // an object scaled unevenly, on its way
  pose.world(1, 1) = 0.5;
  pose.world(2, 3) = 0.1 * frame;
  return pose;
}

}  // namespace

TEST_CASE("a frame is reference, solver, embedding and inverse skinning, one after the other") {
  const Box box;
  Springs solver = box.springs();
  Springs plain = box.springs();
  RiggedMotion motion(box.character, solver);
  motion.reset(pose_at(0));
  plain.reset(motion.reference(pose_at(0)));
  for (int frame = 1; frame < 12; ++frame) {
    const RigPose pose = pose_at(frame);
    const RigPose next = pose_at(frame + 1);
    const bool last = frame == 11;
    const MotionFrame found = motion.step(pose, last ? nullptr : &next);

    const PosedBones bones{pose.bone_matrices, box.character.bone_rest_matrices, pose.armature};
    Positions reference =
        pose_vertices(box.volume.vertices, {box.character.volume_bones, box.character.volume_weights}, bones, Skinning::linear);
    reference =
        (reference * pose.world.topLeftCorner<3, 3>().transpose()).rowwise() + pose.world.topRightCorner<3, 1>().transpose();
    const Positions after = motion.reference(next);
    const Values moved = plain.step(reference, last ? nullptr : &after) - reference;
    const Positions displacements = interpolate(moved, box.volume.tets, box.volume.embedding_tets, box.volume.embedding_weights);
    const Positions local = displacements * pose.world.topLeftCorner<3, 3>().inverse().transpose();
    const InverseSkinning expected =
        inverse_skin({box.character.surface_bones, box.character.surface_weights}, bones, local, Skinning::linear, 0.05);
    CHECK((found.displacements - displacements).cwiseAbs().maxCoeff() < 1e-12);
    CHECK((found.offsets - expected.offsets).cwiseAbs().maxCoeff() < 1e-12);
    CHECK(found.largest_displacement == doctest::Approx(displacements.rowwise().norm().maxCoeff()));
    CHECK(found.largest_displacement > 1e-3);
    CHECK(found.largest_residual < 1e-12);
    CHECK(found.offsets.topRows(4).isZero(0.0));  // pinned
  }
}

TEST_CASE("a frame on a thread of its own is the same frame, to the bit, whatever the number of threads") {
  Box box;
  box.take_skin_of(40'000);
  std::vector<Positions> results[2];
  const int threads = omp_get_max_threads();
  for (const bool beside : {false, true}) {
    omp_set_num_threads(beside ? 1 : 4);
    Springs solver = box.springs();
    RiggedMotion motion(box.character, solver);
    motion.reset(pose_at(0));
    for (int frame = 1; frame < 12; ++frame) {
      const RigPose next = pose_at(frame + 1);
      if (beside) {
        motion.begin(pose_at(frame), std::make_unique<RigPose>(next));
        results[1].push_back(motion.finish().offsets);
      } else {
        results[0].push_back(motion.step(pose_at(frame), &next).offsets);
      }
    }
  }
  omp_set_num_threads(threads);
  REQUIRE(results[0].size() == results[1].size());
  for (std::size_t i = 0; i < results[0].size(); ++i) CHECK(results[0][i] == results[1][i]);
}

TEST_CASE("odd vertices among many come out as one by one, and every instruction set gives the same bits") {
  Box box;
  box.take_skin_of(1'003);  // no multiple of what is computed at once
  box.character.surface_weights.row(7).setZero();
  box.character.surface_bones.row(8).setConstant(no_bone);
  box.character.surface_weights.row(9) *= 1e-3;  // weights count by their shares
  const auto usual = instruction_set();
  std::vector<Positions> first;
  for (const InstructionSet set : available_instruction_sets()) {
    use_instruction_set(set);
    Springs solver = box.springs();
    Springs plain = box.springs();
    RiggedMotion motion(box.character, solver);
    motion.reset(pose_at(0));
    plain.reset(motion.reference(pose_at(0)));
    std::vector<Positions> results;
    for (int frame = 1; frame < 6; ++frame) {
      RigPose pose = pose_at(frame);
      if (frame == 4) pose.bone_matrices.row(1).segment<4>(8) *= 1e-3;  // squashed: some stretches have to be clamped, others not
      const Positions reference = motion.reference(pose);
      const Values moved = plain.step(reference, nullptr) - reference;
      const MotionFrame found = motion.step(pose);
      const Positions displacements =
          interpolate(moved, box.volume.tets, box.character.embedding.tets, box.character.embedding.weights);
      const Positions local = displacements * pose.world.topLeftCorner<3, 3>().inverse().transpose();
      const InverseSkinning expected =
          inverse_skin({box.character.surface_bones, box.character.surface_weights},
                       {pose.bone_matrices, box.character.bone_rest_matrices, pose.armature}, local, Skinning::linear, 0.05);
      CHECK((found.displacements - displacements).cwiseAbs().maxCoeff() < 1e-12);
      CHECK((found.offsets - expected.offsets).cwiseAbs().maxCoeff() < 1e-10);
      CHECK((found.offsets.row(7) - local.row(7)).norm() < 1e-12);
      CHECK((found.largest_residual > 1e-6) == (frame == 4));
      results.push_back(found.offsets);
    }
    if (first.empty()) first = results;
    for (std::size_t i = 0; i < first.size(); ++i) CHECK(results[i] == first[i]);
  }
  use_instruction_set(usual);
}

namespace {

/// Takes its time, on as many threads as it may.
class SlowSolver final : public Solver {
 public:
  explicit SlowSolver(Eigen::Index count) : positions_(count, 3) {}
  Eigen::Index vertex_count() const override { return positions_.rows(); }
  void reset(ConstPositions reference) override { positions_ = reference; }
  const Positions& step(ConstPositions reference, const Positions*) override {
    std::this_thread::sleep_for(std::chrono::milliseconds(60));
    threads = omp_get_max_threads();
    positions_ = reference;
    return positions_;
  }
  SolverState state() const override { return {}; }
  void restore(const SolverState&) override {}
  int threads = 0;

 private:
  Positions positions_;
};

}  // namespace

TEST_CASE("a long frame can be waited for a little at a time, and has the threads that it was promised") {
  const Box box;
  for (const int threads : {1, 3}) {
    SlowSolver solver(box.volume.vertices.rows());
    RiggedMotion motion(box.character, solver, threads);
    CHECK(motion.wait(0.0));  // nothing is under way
    motion.reset(pose_at(0));
    motion.begin(pose_at(1), nullptr);
    CHECK_FALSE(motion.wait(0.001));
    while (!motion.wait(0.01)) {
    }
    CHECK(motion.finish().offsets.isZero(1e-12));
    CHECK(solver.threads == threads);
  }
}

TEST_CASE("bad poses and calls out of order are refused, also from the other thread, and the motion goes on") {
  const Box box;
  Springs solver = box.springs();
  RiggedMotion motion(box.character, solver);
  CHECK_THROWS_AS(motion.finish(), InvalidInput);
  motion.abandon();
  motion.reset(pose_at(0));
  RigPose bad = pose_at(1);
  bad.bone_matrices(1, 3) = std::nan("");
  CHECK_THROWS_AS(motion.step(bad), InvalidInput);
  motion.begin(bad, nullptr);
  CHECK_THROWS_AS(motion.step(pose_at(1)), InvalidInput);  // as one is under way
  CHECK_THROWS_AS(motion.reset(pose_at(0)), InvalidInput);
  CHECK_THROWS_AS(motion.finish(), InvalidInput);
  RigPose flat = pose_at(1);
  flat.world.setZero();
  CHECK_THROWS_AS(motion.step(flat), InvalidInput);
  CHECK(motion.step(pose_at(1)).offsets.allFinite());
  for (int frame = 2; frame < 40; ++frame) motion.begin(pose_at(frame), nullptr);  // and destroyed with frames under way
}

namespace {

using Rounded = Eigen::Matrix<float, Eigen::Dynamic, 3, Eigen::RowMajor>;

/// What `step` gives in the frames 1 to count.
std::vector<MotionFrame> one_by_one(const Box& box, int count) {
  Springs solver = box.springs();
  RiggedMotion motion(box.character, solver);
  motion.reset(pose_at(0));
  std::vector<MotionFrame> frames;
  for (int frame = 1; frame <= count; ++frame) {
    const RigPose next = pose_at(frame + 1);
    frames.push_back(motion.step(pose_at(frame), frame < count ? &next : nullptr));
  }
  return frames;
}

}  // namespace

TEST_CASE("many frames under way are the same frames, rounded, whoever has a hand in them") {
  constexpr int count = 40;
  for (const Skinning skinning : {Skinning::linear, Skinning::dual_quaternion}) {
    Box box;
    box.take_skin_of(3'001);
    box.character.skinning = skinning;
    const std::vector<MotionFrame> expected = one_by_one(box, count);
    for (const int pause : {0, 5}) {  // milliseconds before the first one is finished: without, the caller works, too
      Springs solver = box.springs();
      RiggedMotion motion(box.character, solver);
      motion.reset(pose_at(0));
      std::vector<Rounded> offsets(count, Rounded::Constant(box.vertices.rows(), 3, -1.0F));
      for (int frame = 1; frame <= count; ++frame) {
        auto next = frame < count ? std::make_unique<RigPose>(pose_at(frame + 1)) : nullptr;
        motion.begin(pose_at(frame), std::move(next), offsets[static_cast<std::size_t>(frame - 1)].data());
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(pause));
      for (std::size_t i = 0; i < count; ++i) {
        while (!motion.wait(0.001)) {
        }
        const MotionFrame found = motion.finish();
        CHECK(offsets[i] == expected[i].offsets.cast<float>());
        CHECK(found.offsets.rows() == 0);
        CHECK(found.displacements.rows() == 0);
        CHECK(found.largest_displacement == expected[i].largest_displacement);
        CHECK(found.largest_residual == expected[i].largest_residual);
      }
      CHECK(expected[count - 1].offsets.cwiseAbs().maxCoeff() > 1e-3);
      CHECK_THROWS_AS(motion.finish(), InvalidInput);
    }
  }
}

TEST_CASE("skin that has to be clamped is rounded, too") {
  Box box;
  box.take_skin_of(501);
  Rounded offsets(501, 3);
  Positions expected;
  RigPose squashed = pose_at(2);
  squashed.bone_matrices.row(1).segment<4>(8) *= 1e-3;
  for (const bool rounded : {false, true}) {
    Springs solver = box.springs();
    RiggedMotion motion(box.character, solver);
    motion.reset(pose_at(0));
    motion.step(pose_at(1));
    motion.begin(squashed, nullptr, rounded ? offsets.data() : nullptr);
    const MotionFrame frame = motion.finish();
    CHECK(frame.largest_residual > 1e-6);
    if (!rounded) expected = frame.offsets;
  }
  CHECK(offsets == expected.cast<float>());
}

TEST_CASE("a frame that fails takes those with it that were begun later, and none before") {
  Box box;
  const std::vector<MotionFrame> expected = one_by_one(box, 12);
  for (const int broken : {1, 6, 12}) {
    Springs solver = box.springs();
    RiggedMotion motion(box.character, solver);
    motion.reset(pose_at(0));
    for (int frame = 1; frame <= 12; ++frame) {
      RigPose pose = pose_at(frame);
      if (frame == broken) pose.bone_matrices(1, 3) = std::nan("");
      auto next = frame < 12 && frame + 1 != broken ? std::make_unique<RigPose>(pose_at(frame + 1)) : nullptr;
      motion.begin(pose, std::move(next));
    }
    for (int frame = 1; frame < broken - 1; ++frame) {  // the one before does not know what follows
      CHECK(motion.finish().offsets == expected[static_cast<std::size_t>(frame - 1)].offsets);
    }
    if (broken > 1) motion.finish();
    CHECK_THROWS_AS(motion.finish(), InvalidInput);
    CHECK(motion.wait(0.0));
    CHECK_THROWS_WITH_AS(motion.finish(), doctest::Contains("no frame under way"), InvalidInput);
    motion.reset(pose_at(0));
    const RigPose next = pose_at(2);
    CHECK(motion.step(pose_at(1), &next).offsets == expected[0].offsets);
  }
}

TEST_CASE("an offset that single precision does not hold is an error") {
  Box box;
  Springs solver = box.springs();
  RiggedMotion motion(box.character, solver);
  Rounded offsets(8, 3);
  RigPose far = pose_at(1);
  far.bone_matrices(1, 11) = 1e100;
  motion.reset(pose_at(0));
  motion.step(far);
  const MotionFrame found = motion.step(pose_at(2));
  CHECK(found.offsets.allFinite());
  CHECK(found.offsets.cwiseAbs().maxCoeff() > 1e90);
  motion.reset(pose_at(0));
  motion.step(far);
  motion.begin(pose_at(2), nullptr, offsets.data());
  CHECK_THROWS_WITH_AS(motion.finish(), doctest::Contains("no longer finite"), InvalidInput);
}

TEST_CASE("frames that are abandoned end, and the motion starts over") {
  const Box box;
  const std::vector<MotionFrame> expected = one_by_one(box, 2);
  SlowSolver slow(box.volume.vertices.rows());
  RiggedMotion waiting(box.character, slow, 1);
  waiting.reset(pose_at(0));
  for (int frame = 1; frame < 100; ++frame) waiting.begin(pose_at(frame), nullptr);  // six seconds' worth
  const auto began = std::chrono::steady_clock::now();
  waiting.abandon();
  CHECK(std::chrono::steady_clock::now() - began < std::chrono::seconds(3));
  CHECK(waiting.wait(0.0));
  CHECK_THROWS_AS(waiting.finish(), InvalidInput);

  Springs solver = box.springs();
  RiggedMotion motion(box.character, solver);
  motion.reset(pose_at(0));
  for (int frame = 5; frame < 30; ++frame) motion.begin(pose_at(frame), nullptr);
  motion.abandon();
  motion.reset(pose_at(0));
  const RigPose next = pose_at(2);
  motion.begin(pose_at(1), std::make_unique<RigPose>(next));
  CHECK(motion.finish().offsets == expected[0].offsets);
}

TEST_CASE("a rig that flattens the skin leaves a bounded offset and says what is missing") {
  Box box;
  box.character.minimum_stretch = 0.05;
  Springs solver = box.springs();
  RiggedMotion motion(box.character, solver);
  motion.reset(pose_at(0));
  motion.step(pose_at(1));
  RigPose pose = pose_at(3);
  for (const Eigen::Index entry : {0, 1, 2, 3}) pose.bone_matrices(1, entry) = 0.0;  // the upper bone's x is squashed to nothing
  const MotionFrame frame = motion.step(pose);
  CHECK(frame.largest_residual > 1e-3);
  CHECK(frame.offsets.cwiseAbs().maxCoeff() <= frame.largest_displacement / 0.05 / 0.5 + 1e-12);
}

TEST_CASE("arrays that do not fit each other are refused by name") {
  Box box;
  Springs solver = box.springs();
  box.character.surface_weights.conservativeResize(5, 2);
  CHECK_THROWS_WITH_AS(RiggedMotion(box.character, solver), doctest::Contains("surface_weights"), InvalidInput);
}
