// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// What a textbook would do: Newton's method for a backward Euler step with a linear solver of Eigen's. It is given ImplicitEuler's
/// forces and stiffness and a line search by halves, and starts from the mean of where inertia leads and the skinned increment.
#pragma once

#include <Eigen/IterativeLinearSolvers>
#include <Eigen/SparseCholesky>

#include <cmath>
#include <vector>

#include "elastic/block_matrix.hpp"
#include "followthrough/elastic/elastic_body.hpp"

namespace followthrough {

using SparseMatrix = Eigen::SparseMatrix<double>;
using PlainCholesky = Eigen::SimplicialLDLT<SparseMatrix>;
using PlainConjugateGradients = Eigen::ConjugateGradient<SparseMatrix, Eigen::Lower | Eigen::Upper>;  // diagonal preconditioner

template <typename LinearSolver>
class PlainNewton {
 public:
  PlainNewton(const ElasticBody& body, const Mask& constrained, double dt)
      : body_(body), square_(dt * dt), rows_(numbered(constrained)), blocks_(body.corners(), rows_) {
    const auto size = static_cast<int>(3 * blocks_.row_count());
    matrix_.resize(size, size);
    std::vector<Eigen::Triplet<double>> entries;
    for (Index row = 0; row < blocks_.row_count(); ++row) {
      for (Index k = blocks_.starts()[row]; k < blocks_.starts()[row + 1]; ++k) {
        for (int e = 0; e < 9; ++e) entries.emplace_back(3 * row + e / 3, 3 * blocks_.columns()[k] + e % 3, 0.0);
      }
    }
    matrix_.setFromTriplets(entries.begin(), entries.end());
    if constexpr (std::is_same_v<LinearSolver, PlainCholesky>) {
      linear_.analyzePattern(matrix_);
    } else {
      linear_.setTolerance(1e-3);
    }
  }

  /// @return positions after one step, at a residual of `tolerance` relative to its parts
  Positions step(const Positions& now, const Positions& before, const Positions& reference_now, const Positions& reference,
                 double tolerance) {
    inertial_ = 2 * now - before;
    Positions x = reference;
    for (Eigen::Index v = 0; v < x.rows(); ++v) {
      if (rows_[v] >= 0) x.row(v) = 0.5 * (inertial_.row(v) + now.row(v) + reference.row(v) - reference_now.row(v));
    }
    double energy = 0, relative = 0, size = 0;
    Vector residual = evaluate(x, energy, relative, size);
    bool near = false;
    for (int iteration = 0; iteration < 100 && relative > tolerance; ++iteration) {
      bool advanced = false;
      for (const bool exact : {near, !near}) {
        assemble(x, exact ? Definiteness::kSymmetric : Definiteness::kConvex);
        if constexpr (std::is_same_v<LinearSolver, PlainCholesky>) {
          linear_.factorize(matrix_);
          if (linear_.info() != Eigen::Success || linear_.vectorD().minCoeff() <= 0) continue;
        } else {
          linear_.compute(matrix_);
        }
        const Vector direction = linear_.solve(-residual);
        const double slope = residual.dot(direction), old = size;
        if (!(slope < 0)) continue;
        for (double share = 1; share > 1e-4 && !advanced; share /= 2) {
          Positions next = x;
          for (Eigen::Index v = 0; v < x.rows(); ++v) {
            if (rows_[v] >= 0) next.row(v) += share * direction.segment<3>(3 * rows_[v]).transpose();
          }
          double next_energy = 0, next_relative = 0, next_size = 0;
          Vector next_residual = evaluate(next, next_energy, next_relative, next_size);
          const bool level = next_energy <= energy + 1e-9 * std::abs(energy) && next_size <= (1 - 0.1 * share) * size;
          if (!(next_energy <= energy + 1e-4 * share * slope) && !level) continue;
          advanced = true;
          x = std::move(next);
          residual = std::move(next_residual);
          energy = next_energy;
          relative = next_relative;
          size = next_size;
        }
        if (!advanced) continue;
        near = size < 0.2 * old;
        break;
      }
      if (!advanced) break;
    }
    return x;
  }

 private:
  static std::vector<Index> numbered(const Mask& constrained) {
    std::vector<Index> rows;
    Index count = 0;
    for (Eigen::Index v = 0; v < constrained.size(); ++v) rows.push_back(constrained[v] ? -1 : count++);
    return rows;
  }

  Vector evaluate(const Positions& x, double& energy, double& relative, double& size) const {
    const Positions elastic = body_.internal_forces(x, material_, &energy), away = x - inertial_;
    const Positions inertia = body_.mass_product(away);
    energy = 0.5 * away.cwiseProduct(inertia).sum() + square_ * energy;
    Vector residual(3 * blocks_.row_count());
    double inertia_size = 0, elastic_size = 0;
    size = 0;
    for (Eigen::Index v = 0; v < x.rows(); ++v) {
      if (rows_[v] < 0) continue;
      residual.segment<3>(3 * rows_[v]) = (inertia.row(v) + square_ * elastic.row(v)).transpose();
      inertia_size += inertia.row(v).squaredNorm();
      elastic_size += square_ * square_ * elastic.row(v).squaredNorm();
      size += residual.segment<3>(3 * rows_[v]).squaredNorm() / body_.lumped_mass()[v];
    }
    size = std::sqrt(size);
    relative = residual.norm() / (std::sqrt(inertia_size) + std::sqrt(elastic_size));
    return residual;
  }

  void assemble(const Positions& x, Definiteness definiteness) {
    blocks_.set_zero();
    body_.add_mass(1.0, blocks_);
    body_.add_stiffness(x, material_, definiteness, square_, blocks_);
    for (Index row = 0; row < blocks_.row_count(); ++row) {  // symmetric: rows are columns
      const Index first = blocks_.starts()[row], last = blocks_.starts()[row + 1];
      for (int i = 0; i < 3; ++i) {
        double* to = matrix_.valuePtr() + matrix_.outerIndexPtr()[3 * row + i];
        for (Index k = first; k < last; ++k) {
          for (int j = 0; j < 3; ++j) *to++ = blocks_.blocks()[k](i, j);
        }
      }
    }
  }

  const ElasticBody& body_;
  double square_;
  InvertibleStVK material_;
  std::vector<Index> rows_;
  BlockMatrix blocks_;
  SparseMatrix matrix_;
  LinearSolver linear_;
  Positions inertial_;
};

}  // namespace followthrough
