// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/elastic/elastic_body.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <string>

#include <Eigen/Dense>

#include "elastic/block_matrix.hpp"
#include "elastic/element_batch.hpp"
#include "elastic/element_colors.hpp"
#include "elastic/lane_rows.hpp"
#include "followthrough/errors.hpp"
#include "instruction_set.hpp"

namespace followthrough {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Corners = Eigen::Matrix<double, 3, 4>;  // a column each

// What a tet takes on one core.
constexpr double force_nanoseconds = 20, stiffness_nanoseconds = 200, single_stiffness_nanoseconds = 40, mass_nanoseconds = 5;
// The same for materials and elements without a closed form.
constexpr double decomposed_nanoseconds = 1500;

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

struct Kernels {
  std::uint64_t (*forces)(const BatchConstants*, const ElementRun&, const double*, double, double, double*, double*) noexcept;
  void (*mass)(const double*, const ElementRun&, const double*, double*) noexcept;
  decltype(&baseline::batch_stiffness) stiffness;
  decltype(&baseline::run_stiffness) single_stiffness;
  decltype(&baseline::store_stiffness) store_stiffness;
};

Kernels kernels() {
  return {FOLLOWTHROUGH_KERNEL_OF_TYPE(decltype(Kernels::forces), cluster_forces),
          FOLLOWTHROUGH_KERNEL_OF_TYPE(decltype(Kernels::mass), cluster_mass), FOLLOWTHROUGH_KERNEL(batch_stiffness),
          FOLLOWTHROUGH_KERNEL(run_stiffness), FOLLOWTHROUGH_KERNEL(store_stiffness)};
}

bool has_closed_form(const Material& material) { return dynamic_cast<const InvertibleStVK*>(&material) != nullptr; }

PaddedPositions padded(ConstPositions positions) {
  PaddedPositions all(static_cast<std::size_t>(positions.rows()));
  for (std::size_t v = 0; v < all.size(); ++v) all[v] = {positions(v, 0), positions(v, 1), positions(v, 2), 0};
  return all;
}

Positions unpadded(const PaddedPositions& all) {
  Positions positions(all.size(), 3);
  for (std::size_t v = 0; v < all.size(); ++v) positions.row(static_cast<Eigen::Index>(v)) << all[v].x, all[v].y, all[v].z;
  return positions;
}

Corners corner_gradients(const Matrix3d& gradients) {
  Corners all;
  all.rightCols<3>() = gradients.transpose();
  all.col(0) = -all.rightCols<3>().rowwise().sum();
  return all;
}

}  // namespace

ElasticBody::ElasticBody(ConstPositions rest_positions, ConstTets tets, const ElasticConstants& constants)
    : vertex_count_(rest_positions.rows()), rest_positions_(rest_positions), lumped_mass_(Vector::Zero(rest_positions.rows())) {
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
  arrange();
}

ElasticBody ElasticBody::around(ConstMask vertices) const {
  require_rows("vertices", vertices.size(), vertex_count_);
  ElasticBody part = *this;
  part.corners_.clear();
  part.elements_.clear();
  for (std::size_t tet = 0; tet < corners_.size(); ++tet) {
    if (std::none_of(corners_[tet].begin(), corners_[tet].end(), [&](Index v) { return vertices[v]; })) continue;
    part.corners_.push_back(corners_[tet]);
    part.elements_.push_back(elements_[tet]);
  }
  part.arrange();
  return part;
}

template <typename Constants>
void ElasticBody::fill_batches(const std::vector<Index>& tets, std::vector<Constants>& batches) const {
  using Real = typename Constants::Real;
  constexpr std::size_t lanes = Constants::lanes;
  batches.resize((tets.size() + lanes - 1) / lanes);
  for (std::size_t k = 0; k < batches.size() * lanes; ++k) {
    const Element& element = elements_[tets[std::min(k, tets.size() - 1)]];  // lanes to spare repeat the last one
    Constants& batch = batches[k / lanes];
    const std::size_t lane = k % lanes;
    for (int c = 0; c < 9; ++c) batch.gradients[c][lane] = static_cast<Real>(element.gradients(c / 3, c % 3));
    batch.mu[lane] = static_cast<Real>(element.constants.mu);
    batch.lambda[lane] = static_cast<Real>(element.constants.lambda);
    batch.compression_resistance[lane] = static_cast<Real>(element.constants.compression_resistance);
    batch.volume[lane] = static_cast<Real>(element.volume);
  }
}

// Puts the elements into batches and the batches into colours.
void ElasticBody::arrange() {
  std::vector<Index> all(elements_.size());
  std::iota(all.begin(), all.end(), 0);
  fill_batches(all, batches_);
  fill_batches(all, single_batches_);
  masses_.clear();
  for (const Element& element : elements_) masses_.push_back(element.mass);
  ElementColors colors = color_elements(corners_, vertex_count_);
  color_starts_ = std::move(colors.starts);
  clusters_ = std::move(colors.clusters);
}

ElasticBody::~ElasticBody() = default;
ElasticBody::ElasticBody(const ElasticBody&) = default;
ElasticBody::ElasticBody(ElasticBody&&) noexcept = default;
ElasticBody& ElasticBody::operator=(const ElasticBody&) = default;
ElasticBody& ElasticBody::operator=(ElasticBody&&) noexcept = default;

Vector ElasticBody::rest_stiffness() const {
  Vector stiffness = Vector::Zero(vertex_count_);
  for (std::size_t tet = 0; tet < elements_.size(); ++tet) {
    const Element& element = elements_[tet];
    const Corners gradients = corner_gradients(element.gradients);
    const double modulus = (element.constants.lambda + 4 * element.constants.mu) / 3;
    for (int a = 0; a < 4; ++a) stiffness[corners_[tet][a]] += element.volume * modulus * gradients.col(a).squaredNorm();
  }
  return stiffness;
}

template <typename Work>
void ElasticBody::for_clusters(double tet_nanoseconds, const Work& work) const {
  followthrough::for_clusters(color_starts_, clusters_, elements_.size(), tet_nanoseconds, work);
}

template <typename Work>
void ElasticBody::for_batches(double tet_nanoseconds, const Work& work) const {
  for_clusters(tet_nanoseconds, [&](std::size_t, std::size_t first, std::size_t last) {
    for (std::size_t tet = first; tet < last; tet += batch_lanes) {
      work(tet / batch_lanes, tet, std::min(tet + batch_lanes, last));
    }
  });
}

template <typename Work>
void ElasticBody::for_tets(double tet_nanoseconds, const Work& work) const {
  for_batches(tet_nanoseconds, [&](std::size_t, std::size_t first, std::size_t last) {
    for (std::size_t tet = first; tet < last; ++tet) work(tet);
  });
}

void ElasticBody::load_edges(std::size_t batch, ConstPositions positions, ElementBatch& to) const {
  for (std::size_t lane = 0; lane < batch_lanes; ++lane) {
    const std::array<Index, 4>& v = corners_[std::min(batch * batch_lanes + lane, corners_.size() - 1)];
    for (int axis = 0; axis < 3; ++axis) {
      const double origin = positions(v[0], axis);
      for (int k = 0; k < 3; ++k) to.edges[3 * axis + k][lane] = positions(v[k + 1], axis) - origin;
    }
  }
}

Matrix3d ElasticBody::deformation_gradient(std::size_t tet, const PaddedPositions& positions) const {
  const auto at = [&](int corner) {
    const Padded<double>& p = positions[corners_[tet][corner]];
    return Vector3d(p.x, p.y, p.z);
  };
  Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = at(k + 1) - at(0);
  return edges * elements_[tet].gradients;
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

// Any element of any material. Returns its energy.
template <typename Real>
double ElasticBody::add_force(std::size_t tet, const PaddedPositions& positions, const Material& material, double scale,
                              std::vector<Padded<Real>>& forces) const {
  const Element& element = elements_[tet];
  const SignedSvd svd = signed_svd(deformation_gradient(tet, positions));
  const PrincipalResponse response = material.respond(svd.stretches, element.constants);
  const Matrix3d stress = svd.u * (scale * element.volume * response.stress).asDiagonal() * svd.v.transpose();
  const Corners at_corners = stress * corner_gradients(element.gradients);
  for (int a = 0; a < 4; ++a) {
    Padded<Real>& force = forces[corners_[tet][a]];
    force.x += static_cast<Real>(at_corners(0, a));
    force.y += static_cast<Real>(at_corners(1, a));
    force.z += static_cast<Real>(at_corners(2, a));
  }
  return element.volume * response.energy_density;
}
template double ElasticBody::add_force(std::size_t, const PaddedPositions&, const Material&, double, PaddedPositions&) const;
template double ElasticBody::add_force(std::size_t, const PaddedPositions&, const Material&, double,
                                       std::vector<Padded<float>>&) const;

void ElasticBody::add_internal_forces(const PaddedPositions& positions, const Material& material, double scale,
                                      PaddedPositions& forces, double* energy) const {
  require_rows("positions", static_cast<Eigen::Index>(positions.size()), vertex_count_);
  require_rows("forces", static_cast<Eigen::Index>(forces.size()), vertex_count_);
  Vector energies = Vector::Zero(energy ? static_cast<Eigen::Index>(clusters_.size()) : 0);
  const auto cluster_forces = kernels().forces;
  const bool closed_form = has_closed_form(material);
  for_clusters(closed_form ? force_nanoseconds : decomposed_nanoseconds,
               [&](std::size_t cluster, std::size_t first, std::size_t last) {
                 const auto count = static_cast<int>(last - first);
                 double* const sum = energy ? &energies[static_cast<Eigen::Index>(cluster)] : nullptr;
                 std::uint64_t others = ~std::uint64_t(0);
                 if (closed_form) {
                   others = cluster_forces(&batches_[first / batch_lanes], {corners_[first].data(), count}, &positions.front().x,
                                           scale, InvertibleStVK::smallest_stretch, &forces.front().x, sum);
                 }
                 for (int k = 0; k < count && others >> k != 0; ++k) {
                   if ((others >> k & 1) == 0) continue;
                   const double own = add_force(first + static_cast<std::size_t>(k), positions, material, scale, forces);
                   if (sum) *sum += own;
                 }
               });
  if (energy) *energy = energies.sum();
}

Positions ElasticBody::internal_forces(ConstPositions positions, const Material& material, double* energy) const {
  require_rows("positions", positions.rows(), vertex_count_);
  PaddedPositions forces(static_cast<std::size_t>(vertex_count_));
  add_internal_forces(padded(positions), material, 1, forces, energy);
  return unpadded(forces);
}

Positions ElasticBody::stiffness_product(ConstPositions positions, ConstPositions change, const Material& material,
                                         Definiteness definiteness) const {
  require_rows("positions", positions.rows(), vertex_count_);
  require_rows("change", change.rows(), vertex_count_);
  Positions forces = Positions::Zero(vertex_count_, 3);
  for_tets(decomposed_nanoseconds, [&](std::size_t tet) {
    const Element& element = elements_[tet];
    const StressDerivative derivative =
        material.stress_derivative(deformation_gradient(tet, positions), element.constants, definiteness);
    const Matrix3d stress = element.volume * derivative(deformation_gradient(tet, change));
    const Corners at_corners = stress * corner_gradients(element.gradients);
    for (int a = 0; a < 4; ++a) forces.row(corners_[tet][a]) += at_corners.col(a).transpose();
  });
  return forces;
}

void ElasticBody::add_mass_product(const PaddedPositions& values, PaddedPositions& products) const {
  require_rows("values", static_cast<Eigen::Index>(values.size()), vertex_count_);
  require_rows("products", static_cast<Eigen::Index>(products.size()), vertex_count_);
  const auto cluster_mass = kernels().mass;
  for_clusters(mass_nanoseconds, [&](std::size_t, std::size_t first, std::size_t last) {
    cluster_mass(&masses_[first], {corners_[first].data(), static_cast<int>(last - first)}, &values.front().x, &products.front().x);
  });
}

Positions ElasticBody::mass_product(ConstPositions values) const {
  require_rows("values", values.rows(), vertex_count_);
  PaddedPositions products(static_cast<std::size_t>(vertex_count_));
  add_mass_product(padded(values), products);
  return unpadded(products);
}

// Any element of any material: add(a, b, block) for the corners a <= b.
template <typename Add>
void ElasticBody::for_stiffness_blocks(std::size_t tet, const Matrix3d& gradient, const Material& material,
                                       Definiteness definiteness, double scale, const Add& add) const {
  const Element& element = elements_[tet];
  const StressDerivative d = material.stress_derivative(gradient, element.constants, definiteness);
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
      add(a, b, scale * element.volume * (d.u * block * d.u.transpose()));
    }
  }
}

std::size_t ElasticBody::stiffness_size() const { return elements_.size() * stiffness_floats + single_lanes; }

bool ElasticBody::has_closed_stiffness(const Material& material, Definiteness definiteness) {
  return has_closed_form(material) && definiteness != Definiteness::kSemidefinite;
}

// Of single_lanes elements at most: tets[k] is the number of the one with corners[k].
void ElasticBody::run_stiffness(const SingleBatchConstants& batch, const std::array<Index, 4>* corners, const Index* tets,
                                int count, const PaddedPositions& positions, const Material& material, Definiteness definiteness,
                                double scale, float* to) const {
  const Kernels kernel = kernels();
  const bool convex = definiteness == Definiteness::kConvex;
  const bool closed_form = has_closed_stiffness(material, definiteness);
  const Definiteness other = convex ? Definiteness::kSemidefinite : definiteness;
  SingleStiffness lanes;
  if (closed_form) {
    std::fill_n(&lanes.blocks[10][0][0], 9 * single_lanes, 0.0f);  // what is to spare gets added up, too
    kernel.single_stiffness(batch, {corners->data(), count}, &positions.front().x, static_cast<float>(scale),
                            static_cast<float>(InvertibleStVK::smallest_stretch), convex, lanes);
    kernel.store_stiffness(lanes, count, to);
  }
  for (int lane = 0; lane < count; ++lane, to += stiffness_floats) {
    if (closed_form && lanes.inside[lane] != 0) continue;
    const auto tet = static_cast<std::size_t>(tets[lane]);
    for_stiffness_blocks(tet, deformation_gradient(tet, positions), material, other, scale,
                         [&](int a, int b, const Matrix3d& block) {
                           const auto* const pair = std::find_if(std::begin(stiffness_corners), std::end(stiffness_corners),
                                                                 [&](const int (&p)[2]) { return p[0] == a && p[1] == b; });
                           float* const at = to + 9 * (pair - std::begin(stiffness_corners));
                           for (int k = 0; k < 9; ++k) at[k] = static_cast<float>(block(k / 3, k % 3));
                         });
  }
}

void ElasticBody::element_stiffness(const PaddedPositions& positions, const Material& material, Definiteness definiteness,
                                    double scale, std::vector<float>& stiffness) const {
  require_rows("positions", static_cast<Eigen::Index>(positions.size()), vertex_count_);
  require_rows("stiffness", static_cast<Eigen::Index>(stiffness.size()), static_cast<Eigen::Index>(stiffness_size()));
  const auto runs = static_cast<std::ptrdiff_t>(single_batches_.size());
  const bool closed_form = has_closed_stiffness(material, definiteness);
  const double nanoseconds = single_lanes * (closed_form ? single_stiffness_nanoseconds : decomposed_nanoseconds);
#pragma omp parallel for schedule(static) num_threads(worthwhile_threads(runs, nanoseconds))
  for (std::ptrdiff_t index = 0; index < runs; ++index) {
    const std::size_t first = static_cast<std::size_t>(index) * single_lanes;
    const std::size_t count = std::min<std::size_t>(single_lanes, elements_.size() - first);
    Index tets[single_lanes];
    for (int lane = 0; lane < single_lanes; ++lane) tets[lane] = static_cast<Index>(first) + lane;
    run_stiffness(single_batches_[static_cast<std::size_t>(index)], &corners_[first], tets, static_cast<int>(count), positions,
                  material, definiteness, scale, stiffness.data() + first * stiffness_floats);
  }
}

ElasticBody::Selection ElasticBody::select(const std::vector<Index>& tets) const {
  Selection selection{tets, {}, {}};
  for (const Index tet : tets) selection.corners.push_back(corners_[tet]);
  fill_batches(tets, selection.batches);
  return selection;
}

void ElasticBody::element_stiffness(const Selection& selection, std::size_t first, std::size_t last,
                                    const PaddedPositions& positions, const Material& material, Definiteness definiteness,
                                    double scale, float* to) const {
  for (std::size_t tet = first; tet < last; tet += single_lanes, to += single_lanes * stiffness_floats) {
    run_stiffness(selection.batches[tet / single_lanes], &selection.corners[tet], &selection.tets[tet], single_lanes, positions,
                  material, definiteness, scale, to);
  }
}

void ElasticBody::add_stiffness(ConstPositions positions, const Material& material, Definiteness definiteness, double scale,
                                BlockMatrix& matrix) const {
  const auto batch_stiffness = kernels().stiffness;
  const bool convex = definiteness == Definiteness::kConvex;
  const bool closed_form = has_closed_form(material) && definiteness != Definiteness::kSemidefinite;
  const Definiteness other = convex ? Definiteness::kSemidefinite : definiteness;
  for_batches(closed_form ? stiffness_nanoseconds : decomposed_nanoseconds,
              [&](std::size_t index, std::size_t first, std::size_t last) {
                ElementBatch batch;
                if (closed_form) {
                  load_edges(index, positions, batch);
                  batch_stiffness(batches_[index], batch, InvertibleStVK::smallest_stretch, convex);
                }
                for (std::size_t tet = first; tet < last; ++tet) {
                  const std::size_t lane = tet - first;
                  if (!closed_form || batch.inside[lane] == 0) {
                    for_stiffness_blocks(tet, deformation_gradient(tet, positions), material, other, scale,
                                         [&](int a, int b, const Matrix3d& block) { matrix.add(tet, a, b, block); });
                    continue;
                  }
                  // Corner 0 has minus the sum of the others, as row and as column.
                  Matrix3d rows[3] = {Matrix3d::Zero(), Matrix3d::Zero(), Matrix3d::Zero()};
                  int pair = 0;
                  for (int a = 1; a < 4; ++a) {
                    for (int b = a; b < 4; ++b, ++pair) {
                      Matrix3d block;
                      for (int k = 0; k < 9; ++k) block(k / 3, k % 3) = scale * batch.blocks[pair][k][lane];
                      matrix.add(tet, a, b, block);
                      rows[a - 1] += block;
                      if (a != b) rows[b - 1] += block.transpose();
                    }
                  }
                  for (int a = 1; a < 4; ++a) matrix.add(tet, 0, a, -rows[a - 1].transpose());
                  matrix.add(tet, 0, 0, rows[0] + rows[1] + rows[2]);
                }
              });
}

void ElasticBody::add_mass(double scale, BlockMatrix& matrix) const {
  for_tets(mass_nanoseconds, [&](std::size_t tet) {
    for (int a = 0; a < 4; ++a) {
      for (int b = a; b < 4; ++b) {
        matrix.add(tet, a, b, BlockMatrix::Block::Identity() * (scale * elements_[tet].mass * (a == b ? 2 : 1)));
      }
    }
  });
}

}  // namespace followthrough
