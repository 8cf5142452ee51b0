// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/coarse_rows.hpp"

#include <doctest/doctest.h>

#include <random>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "emulator/newton_kernel.hpp"
#include "instruction_set.hpp"
#include "runs.hpp"

using namespace followthrough;

namespace {

// Rows joined by springs to others that are near in the order, some held as well, with masses between them.
struct Scene {
  explicit Scene(std::int32_t rows) : matrix(Eigen::MatrixXd::Zero(3 * rows, 3 * rows)), held(static_cast<std::size_t>(rows)) {
    std::mt19937 random(3);
    std::normal_distribution<double> number;
    const auto spring = [&] {
      const Eigen::Matrix3d a = Eigen::Matrix3d::NullaryExpr([&] { return number(random); });
      return Eigen::Matrix3d((a * a.transpose()).cast<float>().cast<double>());
    };
    const auto add = [&](std::int32_t row, std::int32_t other, const Eigen::Matrix3d& block) {
      matrix.block<3, 3>(3 * row, 3 * other) += block;
    };
    sums.assign(kNewtonGroup, 0.0f);
    std::vector<std::int32_t> places;
    for (std::int32_t row = 0; row < rows; ++row) {
      places.push_back(static_cast<std::int32_t>(sums.size()));
      sums.resize(sums.size() + kBlock);
      add(row, row, 2.0 * Eigen::Matrix3d::Identity());
      entries.push_back({row, row, places.back(), 2.0});
      held[static_cast<std::size_t>(row)] = row % 7 == 2;
      if (row % 7 == 2) add(row, row, spring());
    }
    for (std::int32_t row = 0; row < rows; ++row) {
      for (const std::int32_t away : {1, 2, 30, 150}) {
        const std::int32_t other = row + away;
        if (other >= rows) continue;
        const Eigen::Matrix3d stiffness = spring(), mass = 0.2 * Eigen::Matrix3d::Identity();
        add(row, row, stiffness);
        add(other, other, stiffness);
        add(row, other, mass - stiffness);
        add(other, row, mass - stiffness);
        entries.push_back({row, other, static_cast<std::int32_t>(sums.size()), 0.2});
        for (int k = 0; k < kBlock; ++k) sums.push_back(static_cast<float>(-stiffness(k / 3, k % 3)));
      }
    }
    for (std::int32_t row = 0; row < rows; ++row) {
      const Eigen::Matrix3d own = matrix.block<3, 3>(3 * row, 3 * row) - 2.0 * Eigen::Matrix3d::Identity();
      const double six[] = {own(0, 0), own(1, 1), own(2, 2), own(0, 1), own(0, 2), own(1, 2)};
      for (std::size_t k = 0; k < 6; ++k)
        sums[static_cast<std::size_t>(places[static_cast<std::size_t>(row)]) + k] = static_cast<float>(six[k]);
    }
    sums.resize(sums.size() + kNewtonGroup);
  }

  // Three columns for each `size` rows, which move as one.
  Eigen::MatrixXd moves(std::int32_t size) const {
    const Eigen::Index rows = matrix.rows() / 3;
    Eigen::MatrixXd result = Eigen::MatrixXd::Zero(matrix.rows(), 3 * ((rows + size - 1) / size));
    for (Eigen::Index row = 0; row < rows; ++row) result.block<3, 3>(3 * row, 3 * (row / size)).setIdentity();
    return result;
  }

  Eigen::MatrixXd matrix;
  std::vector<bool> held;
  std::vector<float> sums;
  std::vector<CoarseEntry> entries;
};

}  // namespace

TEST_CASE("the emulator's coarse system is what dense algebra makes of the matrix, with every instruction set") {
  constexpr std::int32_t rows = 550, aggregate_rows = 64, part_groups = 8;
  const Scene scene(rows);
  std::mt19937 random(5);
  std::normal_distribution<double> number;
  const Eigen::VectorXd residual = Eigen::VectorXd::NullaryExpr(3 * rows, [&] { return number(random); });
  const Usual usual;
  for (const InstructionSet set : available_instruction_sets()) {
    use_instruction_set(set);
    for (const std::int32_t most_nodes : {8, 4, 2}) {
      CAPTURE(most_nodes);
      CoarseRows coarse(rows, part_groups, scene.held, scene.entries, most_nodes);
      REQUIRE(coarse.part_count() == 5);
      REQUIRE(coarse.aggregate_count() == 9);
      const std::int32_t node_rows = part_groups * kNewtonGroup * (most_nodes == 8 ? 1 : most_nodes == 4 ? 2 : 4);
      CHECK(coarse.node_count() == (rows + node_rows - 1) / node_rows);
      const Eigen::MatrixXd aggregates = scene.moves(aggregate_rows), nodes = scene.moves(node_rows);
      const Eigen::VectorXd restricted = aggregates.transpose() * residual;
      // A second time, nothing of the first is left.
      for (int round = 0; round < 2; ++round) {
        for (std::int32_t part = 0; part < coarse.part_count(); ++part) coarse.add_part(part, scene.sums.data());
        coarse.compute();
      }
      Eigen::Map<Eigen::VectorXf>(coarse.restricted(), restricted.size()) = restricted.cast<float>();
      for (std::int32_t part = 0; part < coarse.part_count(); ++part) coarse.correct_part(part);
      coarse.solve_nodes();
      for (std::int32_t part = 0; part < coarse.part_count(); ++part) coarse.add_nodes(part);

      const Eigen::MatrixXd whole = aggregates.transpose() * scene.matrix * aggregates;
      Eigen::VectorXd expected(restricted.size());
      for (Eigen::Index k = 0; k < restricted.size(); k += 3) {
        expected.segment<3>(k) = whole.block<3, 3>(k, k).inverse() * restricted.segment<3>(k);
      }
      const Eigen::VectorXd of_nodes = (nodes.transpose() * scene.matrix * nodes).llt().solve(nodes.transpose() * residual);
      for (Eigen::Index k = 0; k < restricted.size(); k += 3) {
        expected.segment<3>(k) += of_nodes.segment<3>(3 * (k / 3 * aggregate_rows / node_rows));
      }
      expected *= CoarseRows::weight;
      const Eigen::VectorXd found = Eigen::Map<const Eigen::VectorXf>(coarse.corrections(), restricted.size()).cast<double>();
      CHECK((found - expected).norm() < 1e-5 * expected.norm());
      CHECK(coarse.slope() == doctest::Approx(restricted.dot(expected)).epsilon(1e-5));
    }
  }
}
