// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A tet mesh with a material: energy, internal forces, stiffness and mass by linear finite elements. All sums run in an order that
/// does not depend on the number of threads.
#pragma once

#include <array>
#include <vector>

#include "followthrough/elastic/material.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

class BlockMatrix;
struct BatchConstants;
struct ElementBatch;
struct SingleBatchConstants;

/// A vertex's three numbers, so that vector registers can take them at once; the fourth one is 0 and means nothing.
template <typename Real>
struct alignas(4 * sizeof(Real)) Padded {
  Real x = 0, y = 0, z = 0, none = 0;
};
using PaddedPositions = std::vector<Padded<double>>;

/// What a tet mesh is made of. Values at vertices; a tet has the mean of its four vertices'.
struct ElasticConstants {
  Vector youngs_modulus;                ///< (n,) Pa, more than 0
  Vector density;                       ///< (n,) kg/m3, more than 0
  double poisson_ratio = 0.45;          ///< -1 to 0.5, both excluded
  double compression_resistance = 1e5;  ///< relative to Young's modulus, 0 or more
};

class ElasticBody {
 public:
  /// @param rest_positions (n,3) m
  /// @param tets (m,4); inverted ones are taken by their absolute volume
  /// @throws InvalidInput on wrong shapes, indices out of range, non-finite or negative constants, tets without volume
  ElasticBody(ConstPositions rest_positions, ConstTets tets, const ElasticConstants& constants);
  ~ElasticBody();
  ElasticBody(const ElasticBody&);
  ElasticBody(ElasticBody&&) noexcept;
  ElasticBody& operator=(const ElasticBody&);
  ElasticBody& operator=(ElasticBody&&) noexcept;

  /// @param vertices (n,)
  /// @return the same body with only those tets that have a corner among these vertices; its masses are the whole body's
  /// @throws InvalidInput on a wrong shape
  ElasticBody around(ConstMask vertices) const;

  Eigen::Index vertex_count() const { return vertex_count_; }
  /// (n,3) m
  const Positions& rest_positions() const { return rest_positions_; }
  Eigen::Index tet_count() const { return static_cast<Eigen::Index>(elements_.size()); }
  /// Number of tets whose rest volume is negative: usual in volumes that a pose has squashed, worth a warning.
  Eigen::Index inverted_rest_tets() const { return inverted_rest_tets_; }
  /// (n,) kg: a quarter of every adjacent tet's mass.
  const Vector& lumped_mass() const { return lumped_mass_; }
  /// @return (n,) N/m: how each vertex alone resists being moved from rest, the mean over all directions
  Vector rest_stiffness() const;
  /// Mean length of the tets' edges at rest, m.
  double edge_length() const { return edge_length_; }

  /// @param positions (n,3) m, finite
  /// @return J
  double energy(ConstPositions positions, const Material& material) const;

  /// @brief f of M a + f = 0: the gradient of the energy wherever no stretch is beyond the material's clamp.
  /// @param energy where not null, the energy in J
  /// @return (n,3) N
  Positions internal_forces(ConstPositions positions, const Material& material, double* energy = nullptr) const;

  /// @brief The same without an allocation where no energy is asked for: adds scale times the internal forces.
  /// @param positions (n,) m, finite
  /// @param forces (n,) N times scale
  /// @throws InvalidInput on a wrong shape
  void add_internal_forces(const PaddedPositions& positions, const Material& material, double scale, PaddedPositions& forces,
                           double* energy = nullptr) const;

  /// @brief Adds the consistent mass matrix times values, without an allocation.
  /// @param values, products (n,)
  /// @throws InvalidInput on a wrong shape
  void add_mass_product(const PaddedPositions& values, PaddedPositions& products) const;

  /// @return (n,3): change of the internal forces for a small change of the positions, N
  Positions stiffness_product(ConstPositions positions, ConstPositions change, const Material& material,
                              Definiteness definiteness = Definiteness::kExact) const;

  /// @return (n,3): the consistent mass matrix (rho V / 20, doubled on the diagonal) times values
  Positions mass_product(ConstPositions values) const;

  /// Adds scale times the stiffness to a matrix with this body's pattern.
  void add_stiffness(ConstPositions positions, const Material& material, Definiteness definiteness, double scale,
                     BlockMatrix& matrix) const;
  /// Floats of element_stiffness.
  std::size_t stiffness_size() const;
  /// @brief Every element's stiffness times scale in single precision, one after the other.
  /// @param positions (n,) m, finite
  /// @param stiffness out: stiffness_size() floats
  /// @throws InvalidInput on a wrong shape
  void element_stiffness(const PaddedPositions& positions, const Material& material, Definiteness definiteness, double scale,
                         std::vector<float>& stiffness) const;
  /// Elements in an order of one's own, laid out for element_stiffness.
  struct Selection {
    std::vector<Index> tets;
    std::vector<std::array<Index, 4>> corners;
    std::vector<SingleBatchConstants> batches;
  };
  /// @param tets some of them more than once, a multiple of single_lanes
  Selection select(const std::vector<Index>& tets) const;
  /// Whether element_stiffness has a closed form: without it, an element takes a hundred times as long.
  static bool has_closed_stiffness(const Material& material, Definiteness definiteness);
  /// @brief As for all elements, for those of the selection from `first` on to `last`, both multiples of single_lanes. On the
  /// caller's thread.
  /// @param to (last - first) times stiffness_floats
  void element_stiffness(const Selection& selection, std::size_t first, std::size_t last, const PaddedPositions& positions,
                         const Material& material, Definiteness definiteness, double scale, float* to) const;
  /// Adds scale times the consistent mass matrix.
  void add_mass(double scale, BlockMatrix& matrix) const;

  const std::vector<std::array<Index, 4>>& corners() const { return corners_; }

 private:
  struct Element {
    Eigen::Matrix3d gradients;  // rows: derivative of F's columns by corner 1, 2, 3; minus their sum for corner 0
    Moduli constants;
    double volume, mass;  // mass: rho V / 20
  };

  void arrange();
  template <typename Constants>
  void fill_batches(const std::vector<Index>& tets, std::vector<Constants>& batches) const;
  Eigen::Matrix3d deformation_gradient(std::size_t tet, ConstPositions positions) const;
  Eigen::Matrix3d deformation_gradient(std::size_t tet, const PaddedPositions& positions) const;
  friend class BackwardEulerForce;
  template <typename Real>
  double add_force(std::size_t tet, const PaddedPositions& positions, const Material& material, double scale,
                   std::vector<Padded<Real>>& forces) const;
  template <typename Add>
  void for_stiffness_blocks(std::size_t tet, const Eigen::Matrix3d& gradient, const Material& material, Definiteness definiteness,
                            double scale, const Add& add) const;
  template <typename Work>
  void for_clusters(double tet_nanoseconds, const Work& work) const;
  template <typename Work>
  void for_batches(double tet_nanoseconds, const Work& work) const;
  template <typename Work>
  void for_tets(double tet_nanoseconds, const Work& work) const;
  void run_stiffness(const SingleBatchConstants& batch, const std::array<Index, 4>* corners, const Index* tets, int count,
                     const PaddedPositions& positions, const Material& material, Definiteness definiteness, double scale,
                     float* to) const;
  void load_edges(std::size_t batch, ConstPositions positions, ElementBatch& to) const;

  Eigen::Index vertex_count_;
  Positions rest_positions_;
  Eigen::Index inverted_rest_tets_ = 0;
  double edge_length_ = 0;
  Vector lumped_mass_;
  std::vector<std::array<Index, 4>> corners_;
  std::vector<Element> elements_;
  std::vector<BatchConstants> batches_;               // the same as elements_, for the closed form
  std::vector<SingleBatchConstants> single_batches_;  // and in single precision
  std::vector<double> masses_;                        // the same as elements_
  std::vector<Index> color_starts_, clusters_;        // clusters by colour; no two of a colour share a vertex
};

}  // namespace followthrough
