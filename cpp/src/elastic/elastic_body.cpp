// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/elastic_body.hpp"

#include <cmath>
#include <string>

#include <Eigen/Dense>

#include "elastic/block_matrix.hpp"
#include "elastic/element_colors.hpp"
#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Corners = Eigen::Matrix<double, 3, 4>;  // a column each

// Share of the cube over the longest edge below which a tet has no volume.
constexpr double smallest_volume = 1e-14;

void require_positive(const char* name, ConstVector values) {
  for (Eigen::Index v = 0; v < values.size(); ++v) {
    if (!(std::isfinite(values[v]) && values[v] > 0)) {
      throw InvalidInput(
          name, "found " + std::to_string(values[v]) + " at vertex " + std::to_string(v) + ", expected finite numbers above 0");
    }
  }
}

void require_constants(const ElasticConstants& constants, Eigen::Index count) {
  require_rows("youngs_modulus", constants.youngs_modulus.size(), count);
  require_rows("density", constants.density.size(), count);
  require_positive("youngs_modulus", constants.youngs_modulus);
  require_positive("density", constants.density);
  if (!(constants.poisson_ratio > -1 && constants.poisson_ratio < 0.5)) {
    throw InvalidInput("poisson_ratio", "found " + std::to_string(constants.poisson_ratio) + ", expected between -1 and 0.5");
  }
  if (!(std::isfinite(constants.compression_resistance) && constants.compression_resistance >= 0)) {
    throw InvalidInput("compression_resistance",
                       "found " + std::to_string(constants.compression_resistance) + ", expected a finite number, 0 or more");
  }
}

Corners corner_gradients(const Matrix3d& gradients) {
  Corners all;
  all.rightCols<3>() = gradients.transpose();
  all.col(0) = -all.rightCols<3>().rowwise().sum();
  return all;
}

}  // namespace

ElasticBody::ElasticBody(ConstPositions rest_positions, ConstTets tets, const ElasticConstants& constants)
    : vertex_count_(rest_positions.rows()), lumped_mass_(Vector::Zero(rest_positions.rows())) {
  require_finite("rest_positions", rest_positions);
  require_indices("tets", tets, vertex_count_);
  require_constants(constants, vertex_count_);
  if (tets.rows() == 0) throw InvalidInput("tets", "found none, expected at least one");
  corners_.reserve(static_cast<std::size_t>(tets.rows()));
  elements_.reserve(static_cast<std::size_t>(tets.rows()));
  double edges_sum = 0;
  for (Eigen::Index t = 0; t < tets.rows(); ++t) {
    const std::array<Index, 4> corners = {tets(t, 0), tets(t, 1), tets(t, 2), tets(t, 3)};
    Matrix3d edges;
    double longest = 0, modulus = 0, density = 0;
    for (int a = 0; a < 4; ++a) {
      if (a > 0) edges.col(a - 1) = (rest_positions.row(corners[a]) - rest_positions.row(corners[0])).transpose();
      modulus += constants.youngs_modulus[corners[a]] / 4;
      density += constants.density[corners[a]] / 4;
      for (int b = 0; b < a; ++b) {
        const double length = (rest_positions.row(corners[a]) - rest_positions.row(corners[b])).norm();
        longest = std::max(longest, length);
        edges_sum += length;
      }
    }
    const double determinant = edges.determinant();
    if (!(std::abs(determinant) > smallest_volume * longest * longest * longest)) {
      throw InvalidInput("rest_positions", "tet " + std::to_string(t) + " has no volume, expected every tet to fill some space");
    }
    inverted_rest_tets_ += determinant < 0;
    const double volume = std::abs(determinant) / 6, mass = density * volume / 20;
    elements_.push_back(
        {edges.inverse(), moduli(modulus, constants.poisson_ratio, constants.compression_resistance), volume, mass});
    corners_.push_back(corners);
    for (const Index v : corners) lumped_mass_[v] += 5 * mass;
  }
  edge_length_ = edges_sum / (6.0 * static_cast<double>(tets.rows()));
  ElementColors colors = color_elements(corners_, vertex_count_);
  color_starts_ = std::move(colors.starts);
  clusters_ = std::move(colors.clusters);
}

template <typename Work>
void ElasticBody::for_tets(const Work& work) const {
  const std::size_t size = cluster_size;
#pragma omp parallel if (elements_.size() >= 8 * size)
  for (std::size_t color = 0; color + 1 < color_starts_.size(); ++color) {
#pragma omp for schedule(static)
    for (Index k = color_starts_[color]; k < color_starts_[color + 1]; ++k) {
      const std::size_t first = size * static_cast<std::size_t>(clusters_[k]);
      const std::size_t last = std::min(first + size, elements_.size());
      for (std::size_t tet = first; tet < last; ++tet) work(tet);
    }
  }
}

Matrix3d ElasticBody::deformation_gradient(std::size_t tet, ConstPositions positions) const {
  const std::array<Index, 4>& v = corners_[tet];
  Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = (positions.row(v[k + 1]) - positions.row(v[0])).transpose();
  return edges * elements_[tet].gradients;
}

double ElasticBody::energy(ConstPositions positions, const Material& material) const {
  double energy = 0;
  internal_forces(positions, material, &energy);
  return energy;
}

Positions ElasticBody::internal_forces(ConstPositions positions, const Material& material, double* energy) const {
  require_rows("positions", positions.rows(), vertex_count_);
  Positions forces = Positions::Zero(vertex_count_, 3);
  Vector energies = Vector::Zero(energy ? tet_count() : 0);
  for_tets([&](std::size_t tet) {
    const Element& element = elements_[tet];
    const SignedSvd svd = signed_svd(deformation_gradient(tet, positions));
    const PrincipalResponse response = material.respond(svd.stretches, element.constants);
    if (energy) energies[static_cast<Eigen::Index>(tet)] = element.volume * response.energy_density;
    const Matrix3d stress = svd.u * (element.volume * response.stress).asDiagonal() * svd.v.transpose();
    const Corners at_corners = stress * corner_gradients(element.gradients);
    for (int a = 0; a < 4; ++a) forces.row(corners_[tet][a]) += at_corners.col(a).transpose();
  });
  if (energy) *energy = energies.sum();
  return forces;
}

Positions ElasticBody::stiffness_product(ConstPositions positions, ConstPositions change, const Material& material,
                                         Definiteness definiteness) const {
  require_rows("positions", positions.rows(), vertex_count_);
  require_rows("change", change.rows(), vertex_count_);
  Positions forces = Positions::Zero(vertex_count_, 3);
  for_tets([&](std::size_t tet) {
    const Element& element = elements_[tet];
    const StressDerivative derivative =
        material.stress_derivative(deformation_gradient(tet, positions), element.constants, definiteness);
    const Matrix3d stress = element.volume * derivative(deformation_gradient(tet, change));
    const Corners at_corners = stress * corner_gradients(element.gradients);
    for (int a = 0; a < 4; ++a) forces.row(corners_[tet][a]) += at_corners.col(a).transpose();
  });
  return forces;
}

Positions ElasticBody::mass_product(ConstPositions values) const {
  require_rows("values", values.rows(), vertex_count_);
  Positions product = Positions::Zero(vertex_count_, 3);
  for_tets([&](std::size_t tet) {
    const std::array<Index, 4>& v = corners_[tet];
    const Eigen::RowVector3d sum = values.row(v[0]) + values.row(v[1]) + values.row(v[2]) + values.row(v[3]);
    for (const Index corner : v) product.row(corner) += elements_[tet].mass * (sum + values.row(corner));
  });
  return product;
}

void ElasticBody::add_stiffness(ConstPositions positions, const Material& material, Definiteness definiteness, double scale,
                                BlockMatrix& matrix) const {
  for_tets([&](std::size_t tet) {
    const Element& element = elements_[tet];
    const StressDerivative d = material.stress_derivative(deformation_gradient(tet, positions), element.constants, definiteness);
    const Corners g = d.v.transpose() * corner_gradients(element.gradients);
    for (int a = 0; a < 4; ++a) {
      for (int b = a; b < 4; ++b) {
        // In principal axes the block needs the stretches' 3x3 and, for each pair of axes, two numbers.
        Matrix3d block = d.stretch_stiffness.cwiseProduct(g.col(a) * g.col(b).transpose());
        for (int k = 0; k < 3; ++k) {
          const int i = (k + 1) % 3, j = (k + 2) % 3;
          block(i, i) += d.along[k] * g(j, a) * g(j, b);
          block(j, j) += d.along[k] * g(i, a) * g(i, b);
          block(i, j) += d.across[k] * g(j, a) * g(i, b);
          block(j, i) += d.across[k] * g(i, a) * g(j, b);
        }
        matrix.add(tet, a, b, scale * element.volume * (d.u * block * d.u.transpose()));
      }
    }
  });
}

void ElasticBody::add_mass(double scale, BlockMatrix& matrix) const {
  for_tets([&](std::size_t tet) {
    for (int a = 0; a < 4; ++a) {
      for (int b = a; b < 4; ++b) {
        matrix.add(tet, a, b, BlockMatrix::Block::Identity() * (scale * elements_[tet].mass * (a == b ? 2 : 1)));
      }
    }
  });
}

}  // namespace followthrough
