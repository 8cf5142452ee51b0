// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Networks with random weights and blocks of cubes for them to move.
#pragma once

#include <cmath>
#include <random>
#include <vector>

#include "followthrough/emulator/emulator.hpp"

namespace followthrough {

struct Architecture {
  std::vector<Eigen::Index> inertia{64, 64, 64, 64, 64}, force{128, 128, 128, 128, 128}, displacement{192, 192, 192, 192};
  int rings = 1;
  bool sees_reference = true;
  bool biases = true;
};

inline Perceptron random_perceptron(std::mt19937& random, Eigen::Index inputs, const std::vector<Eigen::Index>& widths,
                                    bool biases) {
  Perceptron layers;
  for (const Eigen::Index outputs : widths) {
    std::normal_distribution<float> number(0.0f, 1.0f / std::sqrt(static_cast<float>(inputs)));
    DenseLayer layer;
    layer.weight = layer.weight.NullaryExpr(outputs, inputs, [&] { return number(random); });
    if (biases) layer.bias = layer.bias.NullaryExpr(outputs, [&] { return 0.3f * number(random); });
    layers.push_back(layer);
    inputs = outputs;
  }
  return layers;
}

/// The last layer is damped by `gain`, so that a vertex moves by hundredths of a metre a frame.
inline PatchNetwork random_network(unsigned seed, const Architecture& architecture = {}, float gain = 0.02f) {
  std::mt19937 random(seed);
  const Eigen::Index centre = architecture.sees_reference ? 18 : 9, edge = architecture.sees_reference ? 37 : 19;
  PatchNetwork network;
  network.inertia = random_perceptron(random, centre, architecture.inertia, architecture.biases);
  Eigen::Index joined = architecture.inertia.back();
  for (int r = 0; r < architecture.rings; ++r) {
    network.forces.push_back(random_perceptron(random, edge, architecture.force, architecture.biases));
    joined += architecture.force.back();
  }
  std::vector<Eigen::Index> widths = architecture.displacement;
  widths.push_back(3);
  network.displacement = random_perceptron(random, joined, widths, architecture.biases);
  network.displacement.back().weight *= gain;
  network.displacement.back().bias *= gain;
  return network;
}

/// x * y * z cubes of an edge, constrained where x = 0; E differs from vertex to vertex.
inline EmulatedBody block_of_cubes(int nx, int ny, int nz, double edge = 0.2) {
  const auto vertex = [&](int x, int y, int z) { return static_cast<Index>((x * (ny + 1) + y) * (nz + 1) + z); };
  EmulatedBody body;
  body.rest_positions.resize((nx + 1) * (ny + 1) * (nz + 1), 3);
  body.constrained.resize(body.rest_positions.rows());
  for (int x = 0; x <= nx; ++x) {
    for (int y = 0; y <= ny; ++y) {
      for (int z = 0; z <= nz; ++z) {
        body.rest_positions.row(vertex(x, y, z)) << edge * x, edge * y, edge * z;
        body.constrained[vertex(x, y, z)] = x == 0;
      }
    }
  }
  const int cube[6][4] = {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}};  // bits: x y z
  body.tets.resize(6 * nx * ny * nz, 4);
  Eigen::Index tet = 0;
  for (int x = 0; x < nx; ++x) {
    for (int y = 0; y < ny; ++y) {
      for (int z = 0; z < nz; ++z) {
        for (const auto& corners : cube) {
          for (int k = 0; k < 4; ++k) {
            body.tets(tet, k) = vertex(x + (corners[k] >> 2), y + (corners[k] >> 1 & 1), z + (corners[k] & 1));
          }
          ++tet;
        }
      }
    }
  }
  const Eigen::Index count = body.rest_positions.rows();
  body.youngs_modulus = Vector::LinSpaced(count, 5e4, 5e6);
  body.density = Vector::Constant(count, 1000.0);
  body.dt = std::sqrt(0.001);
  return body;
}

/// Reference positions of a block that swings and turns.
inline Positions swinging(const Positions& rest, int frame) {
  const double t = 0.3 * frame, angle = 0.4 * std::sin(t);
  Eigen::Matrix3d turn;
  turn << std::cos(angle), -std::sin(angle), 0, std::sin(angle), std::cos(angle), 0, 0, 0, 1;
  return (rest * turn.transpose()).rowwise() + Eigen::RowVector3d(0.2 * std::sin(0.7 * t), 0, 0.1 * std::sin(t));
}

}  // namespace followthrough
