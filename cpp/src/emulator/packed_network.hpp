// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A patch network's weights as the kernels want them: first layers split into shares, last layers folded into the displacement
/// perceptron, all in panels. Products of weights are taken in double precision.
#pragma once

#include <cstddef>
#include <vector>

#include "emulator/packed_layers.hpp"
#include "emulator/patch_kernel.hpp"
#include "followthrough/emulator/patch_network.hpp"

namespace followthrough {

/// Features of a vertex are its own motion (five differences of 3 numbers, or two where the network does not see the reference),
/// then k, m, k/m, then 1 where it is constrained.
class PackedNetwork {
 public:
  /// @param network one that require_network accepts
  PackedNetwork(const PatchNetwork& network, Precision precision);

  /// All but the frame's own arrays.
  PatchFrame frame() const;
  bool sees_reference() const { return motion_count_ == 15; }
  Precision precision() const { return precision_; }
  /// Rings, starts and neighbours to be filled in.
  std::vector<RingKernel>& rings() { return rings_; }
  int motion_count() const { return motion_count_; }
  int feature_count() const { return motion_count_ + 4; }
  /// Floats that predict_changes needs.
  std::size_t scratch_size() const;
  /// Multiply-adds a vertex, and a neighbour of each ring.
  double vertex_cost() const { return vertex_cost_; }
  double edge_cost(std::size_t ring) const { return edge_costs_[ring]; }

 private:
  DenseKernel pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias);
  void pack_ring(const Perceptron& perceptron);
  std::vector<DenseKernel> pack_hidden(const Perceptron& perceptron, std::size_t first);
  std::vector<TileLayer> pack_tiles(const Perceptron& perceptron);

  int motion_count_;
  Precision precision_;
  int panel_;  // of the widths
  PackedLayers layers_;
  std::vector<DenseKernel> inertia_, displacement_;
  std::vector<std::vector<DenseKernel>> hidden_;  // of the rings
  std::vector<TileLayer> inertia_tiles_, displacement_tiles_;
  std::vector<std::vector<TileLayer>> hidden_tiles_;  // of the rings
  std::vector<RingKernel> rings_;
  int joined_width_ = 0, widest_ = kPanel;
  double vertex_cost_ = 0;
  std::vector<double> edge_costs_;
};

}  // namespace followthrough
