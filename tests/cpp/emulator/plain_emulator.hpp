// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// The patch network evaluated as it is defined: one patch after the other, one layer after the other, in double precision with the
/// library's tanh. What the emulator is compared with. In bfloat16 the weights and inputs of the layers between a perceptron's
/// first and last are rounded to it first.
#pragma once

#include <cmath>
#include <set>
#include <vector>

#include "followthrough/emulator/emulator.hpp"

namespace followthrough {

class PlainEmulator {
 public:
  /// Takes k (MPa) and m (kg) as the network's units have them, and a mesh in those units.
  PlainEmulator(Positions rest, const Tets& tets, Mask constrained, Vector k, Vector m, PatchNetwork network,
                Precision precision = Precision::float32)
      : rest_(std::move(rest)),
        constrained_(std::move(constrained)),
        k_(std::move(k)),
        m_(std::move(m)),
        network_(std::move(network)),
        precision_(precision) {
    const auto count = static_cast<std::size_t>(rest_.rows());
    std::vector<std::set<Index>> edges(count);
    for (Eigen::Index t = 0; t < tets.rows(); ++t) {
      for (int a = 0; a < 4; ++a) {
        for (int b = 0; b < 4; ++b) edges[static_cast<std::size_t>(tets(t, a))].insert(tets(t, b));
      }
    }
    rings_.resize(count);
    for (std::size_t v = 0; v < count; ++v) {
      std::set<Index> reached{static_cast<Index>(v)};
      for (std::size_t r = 0; r < network_.forces.size(); ++r) {
        std::set<Index> wider = reached;
        for (const Index from : reached)
          wider.insert(edges[static_cast<std::size_t>(from)].begin(), edges[static_cast<std::size_t>(from)].end());
        rings_[v].emplace_back();
        for (const Index w : wider) {
          if (!reached.contains(w)) rings_[v].back().push_back(w);
        }
        reached = wider;
      }
    }
  }

  void reset(const Positions& reference) { u0_ = u1_ = u2_ = x0_ = x1_ = reference; }

  const Positions& step(const Positions& reference) {
    Positions next = reference;
    for (Index i = 0; i < rest_.rows(); ++i) {
      if (!constrained_[i]) next.row(i) = u0_.row(i) + predict(i, reference).transpose();
    }
    u2_ = u1_;
    u1_ = u0_;
    u0_ = next;
    x1_ = x0_;
    x0_ = reference;
    return u0_;
  }

 private:
  using Numbers = std::vector<double>;

  // To the nearest number of 8 significant bits, halfway to the even one.
  static double rounded(double value) {
    const double scale = std::ldexp(1.0, value == 0.0 ? 0 : std::ilogb(value) - 7);
    return scale * std::nearbyint(value / scale);
  }

  Numbers evaluate(const Perceptron& perceptron, Numbers values) const {
    for (std::size_t k = 0; k < perceptron.size(); ++k) {
      DenseLayer layer = perceptron[k];
      if (precision_ == Precision::bfloat16 && k > 0 && k + 1 < perceptron.size()) {
        layer.weight = layer.weight.unaryExpr([](float w) { return static_cast<float>(rounded(static_cast<double>(w))); });
        for (double& value : values) value = rounded(value);
      }
      Numbers outputs;
      for (Eigen::Index out = 0; out < layer.weight.rows(); ++out) {
        double sum = layer.bias.size() ? static_cast<double>(layer.bias[out]) : 0.0;
        for (Eigen::Index in = 0; in < layer.weight.cols(); ++in) {
          sum += static_cast<double>(layer.weight(out, in)) * values[static_cast<std::size_t>(in)];
        }
        outputs.push_back(k + 1 < perceptron.size() ? std::tanh(sum) : sum);
      }
      values = outputs;
    }
    return values;
  }

  // u(t), u(t-1), u(t-2) of j; those of a constrained vertex are a frame ahead where the network does not see the reference.
  std::vector<Eigen::Vector3d> dynamic(Index j, const Positions& reference) const {
    const Positions* frames[3] = {&u0_, &u1_, &u2_};
    if (!network_.sees_reference() && constrained_[j]) {
      frames[0] = &reference;
      frames[1] = &x0_;
      frames[2] = &x1_;
    }
    std::vector<Eigen::Vector3d> result;
    for (const Positions* frame : frames) result.emplace_back((frame->row(j) - rest_.row(j)).transpose());
    return result;
  }

  Eigen::Vector3d predict(Index i, const Positions& reference) const {
    const bool sees_reference = network_.sees_reference();
    const auto displaced = [&](const Positions& frame, Index v) -> Eigen::Vector3d {
      return (frame.row(v) - rest_.row(v)).transpose();
    };
    const Eigen::Vector3d origin = displaced(sees_reference ? x0_ : u0_, i);
    const auto append = [&](Numbers& to, const Eigen::Vector3d& place) {
      for (int axis = 0; axis < 3; ++axis) to.push_back(place[axis] - origin[axis]);
    };
    Numbers centre;
    const std::vector<Eigen::Vector3d> own = dynamic(i, reference);
    for (std::size_t frame = sees_reference ? 0 : 1; frame < 3; ++frame) append(centre, own[frame]);
    if (sees_reference) {
      append(centre, displaced(reference, i));
      append(centre, displaced(x1_, i));
    }
    for (const double value : {k_[i], m_[i], k_[i] / m_[i]}) centre.push_back(value);
    Numbers joined = evaluate(network_.inertia, centre);
    for (std::size_t r = 0; r < network_.forces.size(); ++r) {
      Numbers sum(static_cast<std::size_t>(network_.forces[r].back().weight.rows()), 0.0);
      for (const Index j : rings_[static_cast<std::size_t>(i)][r]) {
        Numbers edge{constrained_[j] ? 1.0 : 0.0};
        for (const Eigen::Vector3d& place : dynamic(j, reference)) append(edge, place);
        if (sees_reference) {
          for (const Positions* frame : {&reference, &x0_, &x1_}) append(edge, displaced(*frame, j));
        }
        edge.insert(edge.end(), centre.begin(), centre.end());
        const Numbers force = evaluate(network_.forces[r], edge);
        for (std::size_t k = 0; k < sum.size(); ++k) sum[k] += force[k];
      }
      joined.insert(joined.end(), sum.begin(), sum.end());
    }
    const Numbers change = evaluate(network_.displacement, joined);
    return {change[0], change[1], change[2]};
  }

  Positions rest_;
  Mask constrained_;
  Vector k_, m_;
  PatchNetwork network_;
  Precision precision_;
  std::vector<std::vector<std::vector<Index>>> rings_;
  Positions u0_, u1_, u2_, x0_, x1_;
};

}  // namespace followthrough
