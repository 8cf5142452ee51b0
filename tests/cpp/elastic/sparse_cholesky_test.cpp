// SPDX-License-Identifier: GPL-3.0-or-later
#include "elastic/sparse_cholesky.hpp"

#include <doctest/doctest.h>

#include <Eigen/Dense>
#include <cstring>

#include "elastic/blocks.hpp"
#include "followthrough/elastic/elastic_body.hpp"
#include "instruction_set.hpp"

using namespace followthrough;

namespace {

ElasticBody body_of(const TetBlock& block) {
  const Eigen::Index count = block.vertices.rows();
  return {block.vertices, block.tets, {Vector::LinSpaced(count, 1e4, 1e6), Vector::Constant(count, 1000.0)}};
}

// Mass and stiffness of a bent block, without the vertices of which `keep` says no.
template <typename Keep>
BlockMatrix bent(const TetBlock& block, double stiffness, const Keep& keep) {
  const ElasticBody body = body_of(block);
  std::vector<Index> rows;
  Index count = 0;
  for (Eigen::Index v = 0; v < block.vertices.rows(); ++v) rows.push_back(keep(v) ? count++ : -1);
  BlockMatrix matrix(body.corners(), rows);
  body.add_mass(1.0, matrix);
  const Positions positions = block.vertices + 0.02 * Positions::Random(block.vertices.rows(), 3);
  body.add_stiffness(positions, InvertibleStVK(), Definiteness::kSemidefinite, stiffness, matrix);
  return matrix;
}

Eigen::MatrixXd dense(const BlockMatrix& matrix) {
  Eigen::MatrixXd all = Eigen::MatrixXd::Zero(3 * matrix.row_count(), 3 * matrix.row_count());
  for (Eigen::Index row = 0; row < matrix.row_count(); ++row) {
    for (Index k = matrix.starts()[row]; k < matrix.starts()[row + 1]; ++k) {
      all.block<3, 3>(3 * row, 3 * matrix.columns()[k]) = matrix.blocks()[k];
    }
  }
  return all;
}

}  // namespace

TEST_CASE("the factor solves to single precision, whatever the shape") {
  const auto all = [](Eigen::Index) { return true; };
  const TetBlock long_block = tet_block(9, 1, 1, 0.2), thick_block = tet_block(5, 4, 4, 0.2);
  // Without every fourth slice the block falls apart.
  const auto slices = [&](Eigen::Index v) { return std::lround(long_block.vertices(v, 0) / 0.2) % 4 != 3; };
  for (const BlockMatrix& matrix :
       {bent(long_block, 1e-3, all), bent(thick_block, 1e-3, all), bent(thick_block, 0.1, all), bent(long_block, 1e-3, slices)}) {
    SparseCholesky factor(matrix);
    CHECK(factor.compute(matrix));
    const Vector b = Vector::Random(3 * matrix.row_count());
    Vector z(b.size());
    factor.apply(b, z);
    const Vector exact = dense(matrix).ldlt().solve(b);
    CHECK((z - exact).norm() < 1e-2 * exact.norm());
    const LinearReport report = solve(matrix, factor, b, 1e-10, 10, z);
    CHECK(report.converged);
    CHECK((z - exact).norm() < 1e-9 * exact.norm());
  }
}

TEST_CASE("an indefinite matrix has no factor, and the next one has") {
  const TetBlock block = tet_block(4, 2, 2, 0.2);
  const auto all = [](Eigen::Index) { return true; };
  const BlockMatrix good = bent(block, 1e-3, all);
  SparseCholesky factor(good);
  CHECK_FALSE(factor.compute(bent(block, -1e-3, all)));
  CHECK(factor.compute(good));
  const Vector b = Vector::Random(3 * good.row_count());
  Vector z(b.size());
  factor.apply(b, z);
  const Vector exact = dense(good).ldlt().solve(b);
  CHECK((z - exact).norm() < 1e-2 * exact.norm());
}

TEST_CASE("the factor has the same bits with every instruction set") {
  const BlockMatrix matrix = bent(tet_block(5, 4, 3, 0.2), 1e-2, [](Eigen::Index v) { return v % 7 != 0; });
  const Vector b = Vector::Random(3 * matrix.row_count());
  const InstructionSet usual = instruction_set();
  std::vector<Vector> results;
  for (const InstructionSet set : available_instruction_sets()) {
    use_instruction_set(set);
    SparseCholesky factor(matrix);
    factor.compute(matrix);
    results.emplace_back(b.size());
    factor.apply(b, results.back());
    CHECK(std::memcmp(results.back().data(), results.front().data(), sizeof(double) * static_cast<std::size_t>(b.size())) == 0);
  }
  use_instruction_set(usual);
}
