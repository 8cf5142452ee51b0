// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Newton passes that a network corrects, in double precision and dense matrices: as newton_patches.hpp and patch_newton.hpp define
/// them, and not as they are fast.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include "emulator/random_network.hpp"
#include "followthrough/emulator/patch_newton.hpp"

namespace followthrough {

struct NewtonWidths {
  int iterations = 4;
  std::string channels;
  std::vector<Eigen::Index> edge, instance;
};

/// Random passes; the last layer is damped by `gain`.
inline NewtonSchedule random_schedule(unsigned seed, const std::vector<NewtonWidths>& passes, float gain = 0.02f) {
  std::mt19937 random(seed);
  NewtonSchedule schedule;
  for (const NewtonWidths& widths : passes) {
    NewtonPass pass;
    pass.iterations = widths.iterations;
    pass.channels = widths.channels;
    if (pass.has_network()) {
      const auto vectors = static_cast<Eigen::Index>(3 * pass.channels.size());
      pass.edge = random_perceptron(random, vectors + 8, widths.edge, true);
      pass.edge.front().bias.resize(0);
      pass.centre = random_perceptron(random, vectors + 17, {widths.edge.front()}, true).front();
      pass.instance = random_perceptron(random, widths.edge.back() + vectors + 17, widths.instance, true);
      pass.out = random_perceptron(random, widths.instance.back(), {3}, false).front();
      pass.out.weight *= gain;
      pass.skip = 0.9f;
    }
    schedule.passes.push_back(pass);
  }
  return schedule;
}

class PlainNewton {
 public:
  PlainNewton(const NewtonBody& body, NewtonSchedule schedule) : schedule_(std::move(schedule)), body_(body) {
    const Eigen::Index n = body.rest_positions.rows();
    std::vector<double> sorted;
    double volume = 0, mass = 0;
    for (Eigen::Index t = 0; t < body.tets.rows(); ++t) {
      Tet tet;
      for (int k = 0; k < 4; ++k) tet.corners[k] = body.tets(t, k);
      const Eigen::Matrix3d edges = edges_of(tet, body.rest_positions);
      tet.volume = std::abs(edges.determinant()) / 6;
      tet.gradients.rightCols<3>() = edges.inverse().transpose();
      for (int k = 0; k < 4; ++k) {
        tet.modulus += body.youngs_modulus[tet.corners[k]] / 4;
        tet.density += body.density[tet.corners[k]] / 4;
      }
      sorted.push_back(tet.volume);
      volume += tet.volume;
      mass += tet.volume * tet.density;
      tets_.push_back(tet);
    }
    std::sort(sorted.begin(), sorted.end());
    const std::size_t half = sorted.size() / 2;
    length_ = std::cbrt(6 * (sorted.size() % 2 ? sorted[half] : (sorted[half] + sorted[half - 1]) / 2));
    masses_ = Eigen::MatrixXd::Zero(n, n);
    near_.resize(static_cast<std::size_t>(n));
    lumped_ = Vector::Zero(n);
    for (Tet& tet : tets_) {
      tet.volume /= length_ * length_ * length_;
      tet.gradients *= length_;
      tet.gradients.col(0) = -tet.gradients.rightCols<3>().rowwise().sum();
      const double s = tet.modulus * body.dt * body.dt / (mass / volume * length_ * length_), nu = body.poisson_ratio;
      tet.mu = s / (2 * (1 + nu));
      tet.lambda = s * nu / ((1 + nu) * (1 - 2 * nu));
      tet.resistance = s * body.compression_resistance;
      const double share = tet.density / (mass / volume) * tet.volume / 20;
      for (const Index a : tet.corners) {
        lumped_[a] += 5 * share;
        for (const Index b : tet.corners) {
          masses_(a, b) += a == b ? 2 * share : share;
          if (a != b) near_[static_cast<std::size_t>(a)].insert(b);
        }
      }
    }
    for (Eigen::Index v = 0; v < n; ++v) {
      if (!body.constrained[v]) free_.push_back(static_cast<Index>(v));
    }
  }

  void reset(const Positions& reference) { u_ = {reference, reference, reference, reference, reference}; }

  const Positions& step(const Positions& reference) {
    const Positions u0 = u_[0] / length_, u1 = u_[1] / length_, u2 = u_[2] / length_;
    const Positions x0 = u_[3] / length_, past = u_[4] / length_, x1 = reference / length_;
    y_ = 2 * u0 - u1;
    Positions w = x1 - x0 - u0 + u1;
    z_ = y_ + schedule_.beta * w;
    for (Eigen::Index v = 0; v < z_.rows(); ++v) {
      if (!body_.constrained[v]) continue;
      w.row(v).setZero();
      z_.row(v) = x1.row(v);
    }
    channels_.assign(128, Positions::Zero(z_.rows(), 3));
    channels_['w'] = w;
    channels_['s'] = u0 - x0;
    channels_['a'] = u0 - 2 * u1 + u2;
    channels_['r'] = x1 - 2 * x0 + past;
    for (std::size_t k = 0; k < schedule_.passes.size(); ++k) {
      assemble(k == 0);
      solve(schedule_.passes[k].iterations);
      const Positions step = schedule_.passes[k].has_network() ? corrected(schedule_.passes[k]) : channels_['g'];
      channels_['w'] = step;
      z_ += step;
    }
    Positions next = z_ * length_;
    for (Eigen::Index v = 0; v < next.rows(); ++v) {
      if (body_.constrained[v]) next.row(v) = reference.row(v);
    }
    u_ = {next, u_[0], u_[1], reference, u_[3]};
    return u_[0];
  }

 private:
  struct Tet {
    Index corners[4];
    double volume = 0, modulus = 0, density = 0, mu = 0, lambda = 0, resistance = 0;
    Eigen::Matrix<double, 3, 4> gradients = Eigen::Matrix<double, 3, 4>::Zero();
  };

  static Eigen::Matrix3d edges_of(const Tet& tet, const Positions& x) {
    Eigen::Matrix3d edges;
    for (int k = 0; k < 3; ++k) edges.col(k) = (x.row(tet.corners[k + 1]) - x.row(tet.corners[0])).transpose();
    return edges;
  }

  static Eigen::Matrix3d cofactors(const Eigen::Matrix3d& f) {
    Eigen::Matrix3d a;
    for (int k = 0; k < 3; ++k) a.row(k) = f.row((k + 1) % 3).cross(f.row((k + 2) % 3));
    return a;
  }

  // Proper rotations; the smallest stretch takes the sign.
  struct Polar {
    Eigen::Matrix3d u, v;
    Eigen::Vector3d stretches;
  };
  static Polar polar(const Eigen::Matrix3d& f) {
    const Eigen::JacobiSVD<Eigen::Matrix3d> svd(f, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Polar p{svd.matrixU(), svd.matrixV(), svd.singularValues()};
    for (Eigen::Matrix3d* side : {&p.u, &p.v}) {
      if (side->determinant() > 0) continue;
      side->col(2) *= -1;
      p.stretches[2] *= -1;
    }
    return p;
  }

  void assemble(bool first) {
    const Eigen::Index n = z_.rows();
    gradient_ = masses_ * (z_ - y_);
    tangent_ = Eigen::MatrixXd::Zero(3 * n, 3 * n);
    std::vector<Eigen::Matrix3d> means(static_cast<std::size_t>(n), Eigen::Matrix3d::Zero());
    Vector volumes = Vector::Zero(n);
    for (Eigen::Index a = 0; a < n; ++a) {
      for (Eigen::Index b = 0; b < n; ++b) tangent_.block<3, 3>(3 * a, 3 * b) += masses_(a, b) * Eigen::Matrix3d::Identity();
    }
    for (const Tet& tet : tets_) {
      Eigen::Matrix3d f = edges_of(tet, z_) * tet.gradients.rightCols<3>().transpose();
      for (const Index v : tet.corners) {
        means[static_cast<std::size_t>(v)] += tet.volume * f;
        volumes[v] += tet.volume;
      }
      const Polar p = polar(f);
      f = p.u * p.stretches.cwiseMax(0.1).asDiagonal() * p.v.transpose();
      const Eigen::Matrix3d a = cofactors(f), one = Eigen::Matrix3d::Identity(), strain = 0.5 * (f.transpose() * f - one);
      const Eigen::Matrix3d s = 2 * tet.mu * strain + tet.lambda * strain.trace() * one;
      const double gap = std::max(1 - f.determinant(), 0.0);
      const double pressure = -tet.resistance * gap * gap / 576, bulk = tet.resistance * gap / 288;
      const bool stretched = s(0, 0) > 0 && s.topLeftCorner<2, 2>().determinant() > 0 && s.determinant() > 0;
      for (int i = 0; i < 4; ++i) {
        const Eigen::Vector3d gi = tet.gradients.col(i);
        gradient_.row(tet.corners[i]) += tet.volume * ((f * s + pressure * a) * gi).transpose();
        for (int j = 0; j < 4; ++j) {
          const Eigen::Vector3d gj = tet.gradients.col(j);
          const Eigen::Vector3d fi = f * gi, fj = f * gj, ai = a * gi, aj = a * gj;
          Eigen::Matrix3d k = tet.mu * (gi.dot(gj) * f * f.transpose() + fj * fi.transpose()) + tet.lambda * fi * fj.transpose() +
                              bulk * ai * aj.transpose();
          if (stretched) k += gi.dot(s * gj) * one;
          tangent_.block<3, 3>(3 * tet.corners[i], 3 * tet.corners[j]) += tet.volume * k;
        }
      }
    }
    if (!first) return;
    frames_.assign(static_cast<std::size_t>(n), {});
    means_ = means;
    for (const Index v : free_) {
      means_[static_cast<std::size_t>(v)] /= volumes[v];
      const Polar p = polar(means_[static_cast<std::size_t>(v)]);
      frames_[static_cast<std::size_t>(v)] = p.u * p.v.transpose();
    }
  }

  Eigen::Matrix3d diagonal(Index v) const { return tangent_.block<3, 3>(3 * v, 3 * v); }

  void solve(int iterations) {
    const Eigen::Index f = static_cast<Eigen::Index>(free_.size());
    Eigen::MatrixXd matrix(3 * f, 3 * f), inverse = Eigen::MatrixXd::Zero(3 * f, 3 * f);
    Vector r(3 * f);
    for (Eigen::Index a = 0; a < f; ++a) {
      const Index v = free_[static_cast<std::size_t>(a)];
      r.segment<3>(3 * a) = -gradient_.row(v).transpose();
      inverse.block<3, 3>(3 * a, 3 * a) = diagonal(v).inverse();
      for (Eigen::Index b = 0; b < f; ++b) {
        matrix.block<3, 3>(3 * a, 3 * b) = tangent_.block<3, 3>(3 * v, 3 * free_[static_cast<std::size_t>(b)]);
      }
    }
    Vector x = Vector::Zero(3 * f), s = inverse * r, p = s;
    const Vector first = s;
    double square = r.dot(s);
    const double enough = 0.003 * 0.003 * square;
    for (int k = 0; k < iterations && square > enough; ++k) {
      const Vector q = matrix * p;
      const double length = square / p.dot(q);
      x += length * p;
      r -= length * q;
      s = inverse * r;
      const double next = r.dot(s);
      p = s + next / square * p;
      square = next;
    }
    for (Eigen::Index a = 0; a < f; ++a) {
      const Index v = free_[static_cast<std::size_t>(a)];
      channels_['g'].row(v) = x.segment<3>(3 * a).transpose();
      channels_['p'].row(v) = first.segment<3>(3 * a).transpose();
      channels_['l'].row(v) = s.segment<3>(3 * a).transpose();
    }
  }

  static Vector tanh_layer(const DenseLayer& layer, const Vector& input) {
    return (layer.weight.cast<double>() * input + layer.bias.cast<double>()).array().tanh().matrix();
  }

  static void put_six(Vector& to, Eigen::Index at, const Eigen::Matrix3d& m, double scale) {
    const double six[] = {m(0, 0), m(1, 1), m(2, 2), m(0, 1), m(0, 2), m(1, 2)};
    for (int k = 0; k < 6; ++k) to[at + k] = std::clamp(scale * six[k], -4.0, 4.0);
  }

  Positions corrected(const NewtonPass& pass) {
    const auto c = static_cast<Eigen::Index>(pass.channels.size());
    const auto square_of = [&](Index v) {
      double sum = 0;
      for (const char letter : pass.channels) sum += channels_[static_cast<std::size_t>(letter)].row(v).squaredNorm();
      return sum;
    };
    const auto log_stiffness = [&](Index v) {
      return body_.constrained[v] ? 0.0 : 0.5 * std::log(diagonal(v).trace() / 3 / lumped_[v]);
    };
    Positions steps = Positions::Zero(z_.rows(), 3);
    for (const Index i : free_) {
      const std::set<Index>& neighbours = near_[static_cast<std::size_t>(i)];
      const Eigen::Matrix3d r = frames_[static_cast<std::size_t>(i)], back = r.transpose();
      double square = square_of(i);
      for (const Index j : neighbours) square += square_of(j);
      const double sigma = std::sqrt(square / (1.0 + static_cast<double>(neighbours.size())) + 1e-18);
      const auto vectors = [&](Vector& to, Index v) {
        for (Eigen::Index k = 0; k < c; ++k) {
          to.segment<3>(3 * k) =
              back * channels_[static_cast<std::size_t>(pass.channels[static_cast<std::size_t>(k)])].row(v).transpose() / sigma;
        }
      };
      Vector centre(3 * c + 17);
      vectors(centre, i);
      centre[3 * c] = 0.25 * std::clamp(std::log(sigma), -12.0, 3.0) + 0.75;
      centre[3 * c + 1] = log_stiffness(i);
      centre[3 * c + 2] = 0.5 * std::log(body_.youngs_modulus[i] * body_.dt * body_.dt / (body_.density[i] * length_ * length_));
      const Eigen::Matrix3d one = Eigen::Matrix3d::Identity(), stretch = back * means_[static_cast<std::size_t>(i)];
      put_six(centre, 3 * c + 3, 0.5 * (stretch + stretch.transpose()) - one, 2);
      const Eigen::Matrix3d stiffness = back * diagonal(i) * r;
      put_six(centre, 3 * c + 9, stiffness / (stiffness.trace() / 3) - one, 1);
      centre[3 * c + 15] = lumped_[i];
      centre[3 * c + 16] = static_cast<double>(neighbours.size()) / 12 - 1;
      const Vector share = pass.centre.weight.cast<double>() * centre + pass.centre.bias.cast<double>();
      Vector sum = Vector::Zero(pass.edge.back().weight.rows());
      for (const Index j : neighbours) {
        Vector edge(3 * c + 8);
        vectors(edge, j);
        const Eigen::Vector3d rest = (body_.rest_positions.row(j) - body_.rest_positions.row(i)).transpose() / length_;
        edge.segment<3>(3 * c) = (back * (z_.row(j) - z_.row(i)).transpose() - rest).cwiseMax(-3).cwiseMin(3);
        edge.segment<3>(3 * c + 3) = rest;
        edge[3 * c + 6] = body_.constrained[j] ? 1 : 0;
        edge[3 * c + 7] = log_stiffness(j);
        Vector h = (pass.edge[0].weight.cast<double>() * edge + share).array().tanh().matrix();
        for (std::size_t k = 1; k < pass.edge.size(); ++k) h = tanh_layer(pass.edge[k], h);
        sum += h / 8;
      }
      Vector h(sum.size() + centre.size());
      h << sum, centre;
      for (const DenseLayer& layer : pass.instance) h = tanh_layer(layer, h);
      const Eigen::Vector3d out = pass.out.weight.cast<double>() * h + static_cast<double>(pass.skip) * centre.head<3>();
      steps.row(i) = sigma * (r * out).transpose();
    }
    return steps;
  }

  NewtonSchedule schedule_;
  NewtonBody body_;
  double length_ = 0;
  std::vector<Tet> tets_;
  Eigen::MatrixXd masses_, tangent_;
  Vector lumped_;
  std::vector<std::set<Index>> near_;
  std::vector<Index> free_;
  std::vector<Eigen::Matrix3d> frames_, means_;
  std::vector<Positions> u_, channels_;
  Positions y_, z_, gradient_;
};

}  // namespace followthrough
