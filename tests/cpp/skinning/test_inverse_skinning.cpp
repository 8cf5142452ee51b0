// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/skinning/inverse_skinning.hpp"

#include <doctest/doctest.h>
#include <omp.h>

#include <limits>

#include "followthrough/errors.hpp"
#include "random_skin.hpp"

using namespace followthrough;
using followthrough::testing::RandomSkin;

namespace {

Positions random_displacements(RandomSkin& skin) {
  Positions displacements(skin.rest_positions.rows(), 3);
  for (Eigen::Index vertex = 0; vertex < displacements.rows(); ++vertex) displacements.row(vertex) = skin.vector(-1, 1);
  return displacements;
}

constexpr Skinning both[] = {Skinning::linear, Skinning::dual_quaternion};

}  // namespace

TEST_SUITE("inverse skinning") {
  TEST_CASE("posing the offset mesh shows the displacement") {
    for (const Skinning skinning : both) {
      RandomSkin skin(500, 7, 1.0);
      const Positions displacements = random_displacements(skin);
      const InverseSkinning inverse = inverse_skin(skin.bone_weights(), skin.bones(), displacements, skinning, 1e-6);
      const Positions moved = skin.rest_positions + inverse.offsets;
      const Positions shown = pose_vertices(moved, skin.bone_weights(), skin.bones(), skinning) -
                              pose_vertices(skin.rest_positions, skin.bone_weights(), skin.bones(), skinning);
      CHECK((shown - displacements).cwiseAbs().maxCoeff() < 1e-9);
      CHECK(inverse.residuals.cwiseAbs().maxCoeff() < 1e-11);
    }
  }

  TEST_CASE("the fused pass equals inverting the Jacobians") {
    for (const Skinning skinning : both) {
      RandomSkin skin(500, 7, 1.0);
      const Positions displacements = random_displacements(skin);
      for (const double minimum_stretch : {0.01, 0.7}) {
        const InverseSkinning fused = inverse_skin(skin.bone_weights(), skin.bones(), displacements, skinning, minimum_stretch);
        const Matrices3 jacobians = skinning_jacobians(500, skin.bone_weights(), skin.bones(), skinning);
        const InverseSkinning apart = invert_displacements(jacobians, displacements, minimum_stretch);
        CHECK((fused.offsets - apart.offsets).cwiseAbs().maxCoeff() < 1e-12);
        CHECK((fused.residuals - apart.residuals).cwiseAbs().maxCoeff() < 1e-12);
      }
    }
  }

  TEST_CASE("through a collapse, offsets stay bounded and what they cannot show is reported") {
    const double minimum_stretch = 0.05;
    const Eigen::RowVector3d displacement(0.3, -0.2, 1.0);
    for (int step = -1000; step <= 1000; ++step) {
      const double stretch = step / 1000.0;
      Matrices3 jacobian(1, 9);
      jacobian << 0, -2, 0, 1, 0, 0, 0, 0, stretch;
      const InverseSkinning inverse = invert_displacements(jacobian, Positions(displacement), minimum_stretch);
      CHECK(inverse.offsets.norm() <= displacement.norm() / minimum_stretch);
      CHECK(inverse.offsets(0, 0) == doctest::Approx(-0.2));
      CHECK(inverse.offsets(0, 1) == doctest::Approx(-0.15));
      const double missing = std::max(0.0, 1.0 - std::abs(stretch) / minimum_stretch);
      CHECK(inverse.residuals(0, 2) == doctest::Approx(missing));
      CHECK(inverse.residuals.leftCols<2>().norm() < 1e-14);
    }
  }

  TEST_CASE("results do not depend on the number of threads") {
    RandomSkin skin(40000, 9, 1.0);  // enough for the work to be shared
    const Positions displacements = random_displacements(skin);
    const int threads = omp_get_max_threads();
    for (const Skinning skinning : both) {
      omp_set_num_threads(1);
      const InverseSkinning alone = inverse_skin(skin.bone_weights(), skin.bones(), displacements, skinning, 0.5);
      for (const int count : {2, 3, 4}) {
        omp_set_num_threads(count);
        const InverseSkinning together = inverse_skin(skin.bone_weights(), skin.bones(), displacements, skinning, 0.5);
        CHECK(together.offsets == alone.offsets);
        CHECK(together.residuals == alone.residuals);
      }
    }
    omp_set_num_threads(threads);
  }

  TEST_CASE("what cannot be used is refused") {
    const double nan = std::numeric_limits<double>::quiet_NaN();
    Matrices3 jacobians(2, 9);
    jacobians << 1, 0, 0, 0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 0, 1;
    const Positions displacements = Positions::Ones(2, 3);
    CHECK_THROWS_AS(invert_displacements(jacobians, displacements, 0.0), InvalidInput);
    CHECK_THROWS_AS(invert_displacements(jacobians, displacements, nan), InvalidInput);
    CHECK_THROWS_AS(invert_displacements(jacobians, Positions::Ones(3, 3), 0.1), InvalidInput);
    CHECK_THROWS_AS(invert_displacements(jacobians, Positions::Constant(2, 3, nan), 0.1), InvalidInput);
    jacobians(1, 4) = nan;
    CHECK_THROWS_AS(invert_displacements(jacobians, displacements, 0.1), InvalidInput);
  }
}
