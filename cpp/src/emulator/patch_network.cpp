// SPDX-License-Identifier: GPL-3.0-or-later
#include "followthrough/emulator/patch_network.hpp"

#include <string>

#include "followthrough/errors.hpp"

namespace followthrough {
namespace {

std::string size_text(Eigen::Index rows, Eigen::Index columns) { return std::to_string(rows) + " x " + std::to_string(columns); }

// Returns the number of outputs.
Eigen::Index require_perceptron(const std::string& name, const Perceptron& perceptron, Eigen::Index inputs) {
  if (perceptron.size() < 2) {
    throw InvalidInput(name, "found " + std::to_string(perceptron.size()) + " layers, expected at least 2");
  }
  for (std::size_t k = 0; k < perceptron.size(); ++k) {
    const DenseLayer& layer = perceptron[k];
    const std::string place = name + "." + std::to_string(2 * k);
    if (layer.weight.cols() != inputs || layer.weight.rows() < 1) {
      throw InvalidInput(place + ".weight", "found " + size_text(layer.weight.rows(), layer.weight.cols()) + ", expected " +
                                                std::to_string(inputs) + " columns, one an input");
    }
    if (layer.bias.size() != 0 && layer.bias.size() != layer.weight.rows()) {
      throw InvalidInput(place + ".bias", "found " + std::to_string(layer.bias.size()) + " numbers, expected " +
                                              std::to_string(layer.weight.rows()) + ", one an output");
    }
    if (!layer.weight.allFinite()) {
      throw InvalidInput(place + ".weight", "found NaN or infinity, expected finite numbers");
    }
    if (!layer.bias.allFinite()) {
      throw InvalidInput(place + ".bias", "found NaN or infinity, expected finite numbers");
    }
    inputs = layer.weight.rows();
  }
  return inputs;
}

}  // namespace

void require_network(const PatchNetwork& network) {
  if (network.inertia.empty()) {
    throw InvalidInput("point_mlp", "found no layers, expected at least 2");
  }
  const Eigen::Index centre = network.inertia.front().weight.cols();
  if (centre != 18 && centre != 9) {
    throw InvalidInput("point_mlp.0.weight", "found " + std::to_string(centre) +
                                                 " columns, expected 18, or 9 for a network that does not see the reference");
  }
  if (network.forces.empty() || network.forces.size() > 3) {
    throw InvalidInput("edge_mlp", "found " + std::to_string(network.forces.size()) + " rings, expected 1 to 3");
  }
  Eigen::Index joined = require_perceptron("point_mlp", network.inertia, centre);
  for (std::size_t ring = 0; ring < network.forces.size(); ++ring) {
    const std::string name = ring == 0 ? "edge_mlp" : "edge_mlp_" + std::to_string(ring + 1);
    joined += require_perceptron(name, network.forces[ring], centre == 18 ? 37 : 19);
  }
  const Eigen::Index outputs = require_perceptron("instance_mlp", network.displacement, joined);
  if (outputs != 3) {
    throw InvalidInput("instance_mlp", "found " + std::to_string(outputs) + " outputs, expected 3");
  }
}

}  // namespace followthrough
