// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The patch network of [DE] (section 3.2, figure 4): three perceptrons that take a vertex and its neighbours one frame further.
/// Its architecture (widths, depths, biases, rings, whether it sees the reference motion) is whatever its weights say.
///
/// What a free vertex i is given, all positions as displacements from the rest shape and relative to i's origin o_i, in the units
/// of Units. u are dynamic positions, x the reference; t+1 is the frame to predict. With reference motion, o_i = x_i(t) and
///   inertia:      u(t), u(t-1), u(t-2), x(t+1), x(t-1) of i, k in MPa, m in kg, k/m                               18 numbers
///   force, of j:  c_j (1 where constrained), u_j(t), u_j(t-1), u_j(t-2), x_j(t+1), x_j(t), x_j(t-1), then the 18   37 numbers
/// Without ([DE] section 4.2, "w/o ref. motion"), o_i = u_i(t), and the history of a constrained vertex is one frame ahead: x(t+1),
/// x(t), x(t-1) stand for its u(t), u(t-1), u(t-2):
///   inertia:      u(t-1), u(t-2) of i, k, m, k/m                                                                   9 numbers
///   force, of j:  c_j, u_j(t), u_j(t-1), u_j(t-2), then the 9                                                     19 numbers
/// The force perceptron's outputs are summed over the neighbours. With more than one ring ([DE] A.5) every ring, the vertices so
/// many edges away, has a perceptron of its own. The displacement perceptron takes the inertia's output and the sums, ring by ring,
/// and gives u(t+1) - u(t).
#pragma once

#include <cmath>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

/// A linear map and its bias.
struct DenseLayer {
  Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> weight;  ///< (outputs, inputs), as PyTorch stores it
  Eigen::VectorXf bias;                                                          ///< (outputs,), or empty: none
};

/// Layers with a tanh between every two, at least two layers.
using Perceptron = std::vector<DenseLayer>;

struct PatchNetwork {
  Perceptron inertia;              ///< `point_mlp`
  std::vector<Perceptron> forces;  ///< `edge_mlp`, and `edge_mlp_2`, `edge_mlp_3` where there are more rings; 1 to 3
  Perceptron displacement;         ///< `instance_mlp`

  /// Whether it sees where the reference is.
  bool sees_reference() const { return inertia.front().weight.cols() == 18; }
};

/// What the network means by its numbers. A scene in other units is mapped to these such that every vertex keeps its dimensionless
/// stiffness s = E h^2 / (rho L^2); backward Euler's motion, in edge lengths, depends on nothing else.
struct NetworkUnits {
  double edge_length = 0.2;      ///< L, m
  double dt = std::sqrt(0.001);  ///< h, s
  double density = 1000.0;       ///< rho, kg/m3
};

/// How a network's hidden layers are computed: in single precision, or from numbers of 8 significant bits whose products are summed
/// in single precision, which needs a processor that does this faster (Intel's AMX, on Linux, or AMD's AVX-512 from Zen 4 on).
enum class Precision { float32, bfloat16 };

/// @throws InvalidInput where the layers do not fit each other or the inputs above, or hold a number that is not finite
void require_network(const PatchNetwork& network);

}  // namespace followthrough
