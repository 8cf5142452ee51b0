// SPDX-License-Identifier: GPL-3.0-or-later
#include "emulator/packed_network.hpp"

#include <algorithm>

namespace followthrough {
namespace {

Eigen::MatrixXd weight_of(const DenseLayer& layer) { return layer.weight.cast<double>(); }

Eigen::VectorXd bias_of(const DenseLayer& layer) {
  return layer.bias.size() ? Eigen::VectorXd(layer.bias.cast<double>()) : Eigen::VectorXd::Zero(layer.weight.rows());
}

}  // namespace

DenseKernel PackedNetwork::pack(const Eigen::MatrixXd& weight, const Eigen::VectorXd& bias) {
  const DenseKernel layer = layers_.pack(weight, bias, panel_);
  widest_ = std::max(widest_, layer.outputs);
  return layer;
}

// The layers that end in a tanh, from `first` on.
std::vector<DenseKernel> PackedNetwork::pack_hidden(const Perceptron& perceptron, std::size_t first) {
  std::vector<DenseKernel> layers;
  for (std::size_t k = first; k + 1 < perceptron.size(); ++k) {
    layers.push_back(pack(weight_of(perceptron[k]), bias_of(perceptron[k])));
  }
  return layers;
}

// The layers between the first and the last in bfloat16, or none.
std::vector<TileLayer> PackedNetwork::pack_tiles(const Perceptron& perceptron) {
  std::vector<TileLayer> layers;
  if (precision_ == Precision::float32) return layers;
  for (std::size_t k = 1; k + 1 < perceptron.size(); ++k) {
    layers.push_back(layers_.pack_tiles(weight_of(perceptron[k]), bias_of(perceptron[k])));
  }
  return layers;
}

void PackedNetwork::pack_ring(const Perceptron& perceptron) {
  // Input: c, then the frames of j relative to o_i, then i's features. A frame of j is j's own feature plus o_j - o_i.
  const Eigen::MatrixXd first = weight_of(perceptron.front());
  const Eigen::Index width = first.rows(), centre_count = motion_count_ + 3, frames = sees_reference() ? 6 : 3;
  const std::vector<int> own = sees_reference() ? std::vector<int>{0, 1, 2, 3, 5} : std::vector<int>{1, 2};  // the rest is zero
  Eigen::MatrixXd neighbour = Eigen::MatrixXd::Zero(width, feature_count());
  Eigen::MatrixXd offset = Eigen::MatrixXd::Zero(width, 3);
  for (std::size_t k = 0; k < own.size(); ++k) {
    neighbour.middleCols(3 * static_cast<Eigen::Index>(k), 3) = first.middleCols(1 + 3 * own[k], 3);
  }
  neighbour.col(feature_count() - 1) = first.col(0);
  for (Eigen::Index f = 0; f < frames; ++f) {
    offset += first.middleCols(1 + 3 * f, 3);
  }
  RingKernel ring{};
  ring.neighbour = pack(neighbour, Eigen::VectorXd::Zero(width));
  ring.centre = pack(first.rightCols(centre_count), bias_of(perceptron.front()));
  std::vector<float> offsets(static_cast<std::size_t>(3 * ring.centre.outputs), 0.0f);
  for (Eigen::Index axis = 0; axis < 3; ++axis) {
    for (Eigen::Index out = 0; out < width; ++out) {
      offsets[static_cast<std::size_t>(axis * ring.centre.outputs + out)] = static_cast<float>(offset(out, axis));
    }
  }
  ring.offset = layers_.keep(offsets);
  hidden_.push_back(pack_hidden(perceptron, 1));
  hidden_tiles_.push_back(pack_tiles(perceptron));
  ring.hidden_count = static_cast<std::int32_t>(hidden_.back().size());
  double cost = 3.0 * static_cast<double>(width);
  for (std::size_t k = 1; k + 1 < perceptron.size(); ++k) {
    cost += static_cast<double>(perceptron[k].weight.size());
  }
  edge_costs_.push_back(cost);
  vertex_cost_ += static_cast<double>(width * (motion_count_ + 1 + centre_count));
  rings_.push_back(ring);
}

PackedNetwork::PackedNetwork(const PatchNetwork& network, Precision precision)
    : motion_count_(network.sees_reference() ? 15 : 6),
      precision_(precision),
      panel_(precision == Precision::float32 ? kPanel : kTilePanel) {
  inertia_ = pack_hidden(network.inertia, 0);
  inertia_tiles_ = pack_tiles(network.inertia);
  for (std::size_t k = 0; k + 1 < network.inertia.size(); ++k) {
    vertex_cost_ += static_cast<double>(network.inertia[k].weight.size());
  }
  for (const Perceptron& perceptron : network.forces) {
    pack_ring(perceptron);
  }
  // A joined row: the inertia's last hidden layer, the sums of the rings' last hidden layers, the rings' numbers of neighbours.
  Eigen::Index column = inertia_.back().outputs;
  for (std::size_t r = 0; r < rings_.size(); ++r) {
    rings_[r].column = static_cast<std::int32_t>(column);
    column += rings_[r].hidden_count ? hidden_[r].back().outputs : rings_[r].centre.outputs;
  }
  const Eigen::MatrixXd first = weight_of(network.displacement.front());
  Eigen::MatrixXd joined = Eigen::MatrixXd::Zero(first.rows(), column + static_cast<Eigen::Index>(rings_.size()));
  Eigen::VectorXd bias = bias_of(network.displacement.front());
  const auto fold = [&](const DenseLayer& last, Eigen::Index input, Eigen::Index into) -> Eigen::VectorXd {
    const auto block = first.middleCols(input, last.weight.rows());
    joined.middleCols(into, last.weight.cols()) = block * weight_of(last);
    vertex_cost_ += static_cast<double>(first.rows() * last.weight.cols());
    return block * bias_of(last);
  };
  bias += fold(network.inertia.back(), 0, 0);
  Eigen::Index input = network.inertia.back().weight.rows();
  for (std::size_t r = 0; r < rings_.size(); ++r) {
    const DenseLayer& last = network.forces[r].back();
    rings_[r].degree_column = static_cast<std::int32_t>(column + static_cast<Eigen::Index>(r));
    joined.col(rings_[r].degree_column) = fold(last, input, rings_[r].column);
    input += last.weight.rows();
  }
  joined_width_ = padded_width(joined.cols(), panel_);
  displacement_.push_back(pack(joined, bias));
  if (precision_ == Precision::bfloat16) {
    displacement_tiles_ = pack_tiles(network.displacement);
    displacement_tiles_.insert(displacement_tiles_.begin(), layers_.pack_split_tiles(joined, bias));
  }
  for (std::size_t k = 1; k < network.displacement.size(); ++k) {
    displacement_.push_back(pack(weight_of(network.displacement[k]), bias_of(network.displacement[k])));
    vertex_cost_ += static_cast<double>(network.displacement[k].weight.size());
  }
  for (std::size_t r = 0; r < rings_.size(); ++r) {
    rings_[r].hidden = hidden_[r].data();
    rings_[r].hidden_tiles = hidden_tiles_[r].data();
  }
}

std::size_t PackedNetwork::scratch_size() const {
  const int row = 3 * widest_ + joined_width_ + padded_width(feature_count());
  const int floats =
      precision_ == Precision::float32 ? kBlockRows * row : kTileBlockRows * (row + kTilePanel + joined_width_ * 3 / 2);
  return static_cast<std::size_t>(floats);
}

PatchFrame PackedNetwork::frame() const {
  PatchFrame frame{};
  frame.feature_count = feature_count();
  frame.inertia_count = static_cast<std::int32_t>(inertia_.size());
  frame.displacement_count = static_cast<std::int32_t>(displacement_.size());
  frame.ring_count = static_cast<std::int32_t>(rings_.size());
  frame.inertia = inertia_.data();
  frame.rings = rings_.data();
  frame.displacement = displacement_.data();
  frame.inertia_tiles = inertia_tiles_.data();
  frame.displacement_tiles = displacement_tiles_.data();
  frame.joined_width = joined_width_;
  frame.widest = widest_;
  return frame;
}

}  // namespace followthrough
