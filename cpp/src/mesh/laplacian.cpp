// SPDX-License-Identifier: GPL-3.0-or-later
#include "laplacian.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <stdexcept>
#include <vector>

#include <Eigen/Dense>
#include <Eigen/Sparse>

#include "bucket_sort.hpp"
#include "disjoint_sets.hpp"
#include "tet_weights.hpp"
#include "worthwhile_threads.hpp"

namespace followthrough {
namespace {

using Sparse = Eigen::SparseMatrix<double>;
using Triplets = std::vector<Eigen::Triplet<double>>;

// Couplings (positive numbers pull two vertices together) between the vertices, each pair both ways, no diagonal.
Sparse couplings(ConstPositions vertices, ConstTets tets, Stencil stencil) {
  Triplets entries;
  entries.reserve(12 * static_cast<std::size_t>(tets.rows()));
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    const TetCorners x = {vertices.row(tets(t, 0)), vertices.row(tets(t, 1)), vertices.row(tets(t, 2)), vertices.row(tets(t, 3))};
    if (!tet_is_solid(x)) continue;
    Eigen::Matrix3d edges;
    edges << x[1] - x[0], x[2] - x[0], x[3] - x[0];
    Eigen::Matrix<double, 4, 3> gradients;
    gradients.bottomRows<3>() = edges.inverse();
    gradients.row(0) = -gradients.bottomRows<3>().colwise().sum();
    const Eigen::Matrix4d stiffness = std::abs(tet_determinant(x)) / 6 * gradients * gradients.transpose();
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        if (a != b) entries.emplace_back(tets(t, a), tets(t, b), -stiffness(a, b));
      }
    }
  }
  Sparse matrix(vertices.rows(), vertices.rows());
  matrix.setFromTriplets(entries.begin(), entries.end());
  if (stencil == Stencil::kNonnegative) {
    double largest = 0;
    for (Eigen::Index k = 0; k < matrix.nonZeros(); ++k) largest = std::max(largest, matrix.valuePtr()[k]);
    // A whisper of coupling along every edge, so that leaving couplings out cannot cut a vertex off.
    for (Eigen::Index k = 0; k < matrix.nonZeros(); ++k) matrix.valuePtr()[k] = std::max(matrix.valuePtr()[k], 1e-9 * largest);
  }
  return matrix;
}

}  // namespace

struct LaplaceSolver::State {
  Mask given;
  std::vector<Index> free;
  Sparse to_given;  // free x n
  Eigen::SimplicialLDLT<Sparse> factor;
};

LaplaceSolver::LaplaceSolver(ConstPositions vertices, ConstTets tets, const Mask& given, Stencil stencil)
    : state_(std::make_unique<State>()) {
  const Eigen::Index count = vertices.rows();
  const Sparse coupling = couplings(vertices, tets, stencil);
  DisjointSets sets(static_cast<std::size_t>(count));
  for (int column = 0; column < coupling.outerSize(); ++column) {
    for (Sparse::InnerIterator entry(coupling, column); entry; ++entry) {
      if (entry.value() != 0) sets.join(static_cast<Index>(entry.row()), static_cast<Index>(entry.col()));
    }
  }
  std::vector<char> anchored(static_cast<std::size_t>(count), 0);
  for (Eigen::Index v = 0; v < count; ++v) {
    if (given[v]) anchored[static_cast<std::size_t>(sets.find(static_cast<Index>(v)))] = 1;
  }
  state_->given = given;
  std::vector<Index> row(static_cast<std::size_t>(count), -1);
  for (Eigen::Index v = 0; v < count; ++v) {
    if (!anchored[static_cast<std::size_t>(sets.find(static_cast<Index>(v)))]) state_->given[v] = true;
    if (state_->given[v]) continue;
    row[static_cast<std::size_t>(v)] = static_cast<Index>(state_->free.size());
    state_->free.push_back(static_cast<Index>(v));
  }
  const auto unknowns = static_cast<Eigen::Index>(state_->free.size());
  Triplets inner, outer;
  for (const Index v : state_->free) {
    const Index own = row[static_cast<std::size_t>(v)];
    double diagonal = 0;
    for (Sparse::InnerIterator entry(coupling, v); entry; ++entry) {
      diagonal += entry.value();
      const Index other = row[static_cast<std::size_t>(entry.row())];
      if (other >= 0) {
        inner.emplace_back(own, other, -entry.value());
      } else {
        outer.emplace_back(own, static_cast<Index>(entry.row()), entry.value());
      }
    }
    inner.emplace_back(own, own, diagonal);
  }
  Sparse system(unknowns, unknowns);
  system.setFromTriplets(inner.begin(), inner.end());
  state_->to_given.resize(unknowns, count);
  state_->to_given.setFromTriplets(outer.begin(), outer.end());
  if (unknowns > 0) {
    state_->factor.compute(system);
    if (state_->factor.info() != Eigen::Success) throw std::runtime_error("the Laplace system of the tet mesh cannot be factored");
  }
}

LaplaceSolver::~LaplaceSolver() = default;
LaplaceSolver::LaplaceSolver(LaplaceSolver&&) noexcept = default;
LaplaceSolver& LaplaceSolver::operator=(LaplaceSolver&&) noexcept = default;

const Mask& LaplaceSolver::given() const noexcept { return state_->given; }

void LaplaceSolver::solve(Values& values) const {
  if (state_->free.empty()) return;
  const double column_cost = 4.0 * static_cast<double>(state_->factor.matrixL().nestedExpression().nonZeros());  // ns
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(values.cols(), column_cost))
  for (Eigen::Index column = 0; column < values.cols(); ++column) {
    Vector known = values.col(column);
    const Vector solution = state_->factor.solve(state_->to_given * known);
    for (std::size_t k = 0; k < state_->free.size(); ++k) values(state_->free[k], column) = solution[static_cast<Eigen::Index>(k)];
  }
}

Mask boundary_vertices(ConstTets tets, Eigen::Index vertex_count) {
  std::vector<std::array<Index, 3>> faces;
  faces.reserve(4 * static_cast<std::size_t>(tets.rows()));
  Mask boundary = Mask::Constant(vertex_count, true);
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    for (int left_out = 0; left_out < 4; ++left_out) {
      std::array<Index, 3> face{};
      std::size_t at = 0;
      for (int k = 0; k < 4; ++k) {
        boundary[tets(t, k)] = false;
        if (k != left_out) face[at++] = tets(t, k);
      }
      std::sort(face.begin(), face.end());
      faces.push_back(face);
    }
  }
  faces = bucket_sorted(
      faces, static_cast<std::size_t>(vertex_count), [](const std::array<Index, 3>& face) { return face[0]; },
      std::less<std::array<Index, 3>>());
  for (std::size_t first = 0, last = 0; first < faces.size(); first = last) {
    while (last < faces.size() && faces[last] == faces[first]) ++last;
    if (last - first != 1) continue;
    for (const Index v : faces[first]) boundary[v] = true;
  }
  return boundary;
}

}  // namespace followthrough
