// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// Newton passes that guides make the steps of, in double precision and dense matrices: as newton_patches.hpp and patch_newton.hpp
/// define them, and not as they are fast.
#pragma once

#include <algorithm>
#include <cmath>
#include <random>
#include <set>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include "emulator/random_network.hpp"
#include "followthrough/emulator/patch_newton.hpp"

namespace followthrough {

struct NewtonWidths {
  int iterations = 4;
  bool guided = true;
  std::vector<Eigen::Index> hidden;
};

inline Guide random_guide(std::mt19937& random, GuideSize size, std::vector<Eigen::Index> widths, float first, float gain) {
  widths.push_back(size.vectors);
  Guide guide = random_perceptron(random, size.vectors * (size.vectors + 1) / 2 + size.scalars, widths, true);
  guide.back().weight *= gain;
  guide.back().bias *= gain;
  guide.back().bias[0] += first;
  return guide;
}

/// Random guides whose coefficients are `gain` off those of a half way start and of whole steps; as many passes as are named.
inline NewtonSchedule random_schedule(unsigned seed, const std::vector<NewtonWidths>& passes, float gain = 0.05f) {
  std::mt19937 random(seed);
  NewtonSchedule schedule;
  schedule.start = random_guide(random, start_guide_size(), {24, 17}, 0.5f, gain);
  for (const NewtonWidths& widths : passes) {
    schedule.passes.push_back({widths.iterations, {}});
    if (widths.guided) schedule.passes.back().guide = random_guide(random, pass_guide_size(), widths.hidden, 0.9f, gain);
  }
  schedule.most_passes = static_cast<int>(passes.size());
  schedule.tolerance = 0.0;
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
    pins_ = Vector::Zero(n);
    if (body.pin_stiffness.size()) pins_ = body.pin_stiffness * (body.dt * body.dt / (mass / volume * length_ * length_ * length_));
    for (Eigen::Index v = 0; v < n; ++v) {
      if (!body.constrained[v]) free_.push_back(static_cast<Index>(v));
    }
    // Tets to the nearest constrained vertex.
    hops_.assign(static_cast<std::size_t>(n), 20);
    for (int round = 0; round < 20; ++round) {
      for (Eigen::Index v = 0; v < n; ++v) {
        int& mine = hops_[static_cast<std::size_t>(v)];
        if (body.constrained[v]) mine = 0;
        for (const Index other : near_[static_cast<std::size_t>(v)])
          mine = std::min(mine, hops_[static_cast<std::size_t>(other)] + 1);
      }
    }
  }

  void reset(const Positions& reference) { u_.assign(7, reference); }

  const Positions& step(const Positions& reference) {
    std::vector<Positions> u;
    for (const Positions& frame : u_) u.push_back(frame / length_);
    const Positions x1 = reference / length_, &x0 = u[4];
    x1_ = x1;
    y_ = 2 * u[0] - u[1];
    z_ = y_;
    slow_ = false;
    guides_ = directions_exact_ = true;
    steps_ = 0;
    rate_ = 0;
    Positions w = x1 - x0 - u[0] + u[1];
    for (Eigen::Index v = 0; v < z_.rows(); ++v) {
      if (!body_.constrained[v]) continue;
      z_.row(v) = x1.row(v);
      w.row(v) = x1.row(v) - y_.row(v);
    }
    const Positions a = u[0] - 2 * u[1] + u[2], s = u[0] - x0;
    z_ +=
        guided(schedule_.start,
               {w, a, s, x1 - 2 * x0 + u[5], u[0] - 3 * u[1] + 3 * u[2] - u[3], x0 - 2 * u[5] + u[6], means(w), means(a), means(s)},
               [&](Index v) -> std::vector<double> { return {nearness(v), log_modulus(v), fullness(v)}; });
    take_passes();
    // The reference, where that has less energy.
    double inertia = 0;
    for (const Index v : free_) inertia += 0.5 * lumped_[v] * (x1.row(v) - y_.row(v)).squaredNorm();
    if (schedule_.most_passes > 0 && inertia < energy_) {
      const Positions found = z_;
      const double energy = energy_;
      for (const Index v : free_) z_.row(v) = x1.row(v);
      exact_ = false;
      assemble();
      if (energy_ < energy) {
        ++from_reference;
        take_passes();
      } else {
        z_ = found;
      }
    }
    Positions next = z_ * length_;
    for (Eigen::Index v = 0; v < next.rows(); ++v) {
      if (body_.constrained[v]) next.row(v) = reference.row(v);
    }
    u_ = {next, u_[0], u_[1], u_[2], reference, u_[4], u_[5]};
    return u_[0];
  }

  int not_kept = 0;        ///< steps that made the energy worse
  int from_reference = 0;  ///< frames that went there
  int exact_passes = 0;    ///< with the exact tangent

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

  // With the convex tangent where a diagonal block of the exact one is not positive definite.
  void assemble() {
    assemble_as(exact_);
    if (!exact_) return;
    for (const Index v : free_) exact_ = exact_ && diagonal(v).llt().info() == Eigen::Success;
    if (!exact_) assemble_as(false);
  }

  void assemble_as(bool exact) {
    const Eigen::Index n = z_.rows();
    gradient_ = masses_ * (z_ - y_);
    // Without what free vertices have no part in.
    Positions held = z_ - y_;
    for (const Index v : free_) held.row(v).setZero();
    energy_ = 0.5 * (gradient_.cwiseProduct(z_ - y_).sum() - held.cwiseProduct(masses_ * held).sum());
    tangent_ = Eigen::MatrixXd::Zero(3 * n, 3 * n);
    for (const Index v : free_) {
      const Eigen::RowVector3d lag = z_.row(v) - x1_.row(v);
      gradient_.row(v) += pins_[v] * lag;
      energy_ += 0.5 * pins_[v] * lag.squaredNorm();
      tangent_.block<3, 3>(3 * v, 3 * v) += pins_[v] * Eigen::Matrix3d::Identity();
    }
    for (Eigen::Index a = 0; a < n; ++a) {
      for (Eigen::Index b = 0; b < n; ++b) tangent_.block<3, 3>(3 * a, 3 * b) += masses_(a, b) * Eigen::Matrix3d::Identity();
    }
    for (const Tet& tet : tets_) {
      Eigen::Matrix3d f = edges_of(tet, z_) * tet.gradients.rightCols<3>().transpose();
      const Polar p = polar(f);
      f = p.u * p.stretches.cwiseMax(0.1).asDiagonal() * p.v.transpose();
      const Eigen::Matrix3d a = cofactors(f), one = Eigen::Matrix3d::Identity(), strain = 0.5 * (f.transpose() * f - one);
      const Eigen::Matrix3d s = 2 * tet.mu * strain + tet.lambda * strain.trace() * one;
      const double gap = std::max(1 - f.determinant(), 0.0);
      const double pressure = -tet.resistance * gap * gap / 576, bulk = tet.resistance * gap / 288;
      const Eigen::Matrix3d below = p.u * (p.stretches - p.stretches.cwiseMax(0.1)).asDiagonal() * p.v.transpose();
      const bool moves = std::any_of(tet.corners, tet.corners + 4, [&](Index v) { return !body_.constrained[v]; });
      energy_ += (moves ? tet.volume : 0.0) * (0.5 * strain.cwiseProduct(s).sum() + tet.resistance * std::pow(gap / 12, 3) +
                                               (f * s + pressure * a).cwiseProduct(below).sum());
      const bool stretched = s(0, 0) > 0 && s.topLeftCorner<2, 2>().determinant() > 0 && s.determinant() > 0;
      for (int i = 0; i < 4; ++i) {
        const Eigen::Vector3d gi = tet.gradients.col(i);
        gradient_.row(tet.corners[i]) += tet.volume * ((f * s + pressure * a) * gi).transpose();
        for (int j = 0; j < 4; ++j) {
          const Eigen::Vector3d gj = tet.gradients.col(j);
          const Eigen::Vector3d fi = f * gi, fj = f * gj, ai = a * gi, aj = a * gj;
          Eigen::Matrix3d k = tet.mu * (gi.dot(gj) * f * f.transpose() + fj * fi.transpose()) + tet.lambda * fi * fj.transpose() +
                              bulk * ai * aj.transpose();
          if (stretched || exact) k += gi.dot(s * gj) * one;
          if (exact) {
            // What turns the cofactors: d(A g_i) along j.
            const Eigen::Vector3d axis = pressure * f * gi.cross(gj);
            Eigen::Matrix3d turn;
            turn << 0, axis.z(), -axis.y(), -axis.z(), 0, axis.x(), axis.y(), -axis.x(), 0;
            k += turn;
          }
          tangent_.block<3, 3>(3 * tet.corners[i], 3 * tet.corners[j]) += tet.volume * k;
        }
      }
    }
    left_ = 0;
    for (const Index v : free_) left_ += (diagonal(v).inverse() * gradient_.row(v).transpose()).squaredNorm();
    left_ = std::sqrt(left_ / (3.0 * static_cast<double>(free_.size())));
  }

  void take_passes() {
    Positions last = Positions::Zero(z_.rows(), 3);
    double reach = 1;
    exact_ = false;
    for (int k = 0; k < schedule_.most_passes; ++k) {
      const NewtonPass& pass = schedule_.passes[std::min(static_cast<std::size_t>(k), schedule_.passes.size() - 1)];
      assemble();
      const double before = left_;
      const double expected = rate_ > 0 ? left_ * std::max(reach, 1.0) / (1 - std::min(rate_, 0.9)) : left_;
      const int iterations = slow_ ? 2 * pass.iterations : pass.iterations;
      if (!solve(iterations) && exact_) {
        exact_ = false;
        assemble();
        solve(iterations);
      }
      exact_passes += exact_;
      directions_exact_ = directions_exact_ && taken_ < pass.iterations;
      reach = g_.norm() / std::sqrt(3.0 * static_cast<double>(free_.size())) / before;
      const bool of_guide = !pass.guide.empty() && (!directions_exact_ || (guides_ && steps_ < 2)),
                 last_one = k + 1 == schedule_.most_passes;
      last = of_guide
                 ? guided(pass.guide, {g_, p_, l_, last, means(g_), means(l_)},
                          [&](Index v) -> std::vector<double> {
                            return {0.5 * std::log(diagonal(v).trace() / 3 / lumped_[v]), log_modulus(v), nearness(v), fullness(v)};
                          })
                 : g_;
      exact_ = directions_exact_ && steps_ >= 1 && expected < 0.02 && !last_one;
      const double share = keep(last, of_guide, last_one);
      rate_ = share == 0 ? 0.0 : left_ / before;
      slow_ = slow_ || rate_ > 0.5;
      guides_ = guides_ && (steps_ == 0 || rate_ <= 0.5);
      ++steps_;
      if (share == 0) break;
      if (share > 0) last = share * g_;
    }
  }

  // Moves by a step if that brings the energy down, else by a share of the direction. Returns that share; -1: the step was kept.
  double keep(const Positions& step, bool of_guide, bool last) {
    const Positions start = z_, direction = g_;
    const double energy = energy_, left = left_, slope = slope_;
    const auto move = [&](const Positions& by) {
      z_ = start + by;
      assemble();
    };
    const auto good = [&](double share) {
      double change = 1e-4 * share * slope;
      if (share == 0 && !last) change = std::min(-slope, 0.25 * energy);
      return energy_ <= energy + change + (left_ < left ? 1e-4 : 1e-6) * std::abs(energy);
    };
    move(step);
    double share = of_guide ? 0 : 1;
    if (good(share)) return -1;
    ++not_kept;
    for (int retry = 0; retry < 6; ++retry) {
      const double least = -0.5 * slope * share * share / (energy_ - energy - slope * share);
      share = share == 0 ? 1 : std::isfinite(least) ? std::clamp(least, 0.1 * share, 0.5 * share) : 0.1 * share;
      move(share * direction);
      if (!good(share)) continue;
      const double slope_there = gradient_.cwiseProduct(direction).sum();
      if (share == 1 && slope_there < 0.1 * slope) {
        // The cubic through both energies and slopes.
        const double there = energy_, bend = slope + slope_there - 3 * (there - energy);
        const double root = std::sqrt(bend * bend - slope * slope_there);
        const double farther = 1 - (slope_there + root - bend) / (slope_there - slope + 2 * root);
        if (farther > 1) {
          share = std::clamp(farther, 1.2, 3.0);
          move(share * direction);
          if (!(energy_ < there)) move((share = 1) * direction);
        }
      }
      return share;
    }
    move(0 * direction);
    return 0;
  }

  Eigen::Matrix3d diagonal(Index v) const { return tangent_.block<3, 3>(3 * v, 3 * v); }

  // False where the curvature along a direction was not positive: the last solution before that.
  bool solve(int iterations) {
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
    const Vector before = r;
    for (Positions* channel : {&g_, &p_, &l_}) *channel = Positions::Zero(z_.rows(), 3);
    Vector x = Vector::Zero(3 * f), s = inverse * r, p = s;
    const Vector first = s;
    double square = r.dot(s);
    bool definite = true;
    const double tolerance = slow_ ? 0.003 : 0.01, enough = tolerance * tolerance * square;
    for (taken_ = 0; taken_ < iterations && square > enough; ++taken_) {
      const Vector q = matrix * p;
      definite = p.dot(q) > 0;
      if (!definite) break;
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
      g_.row(v) = x.segment<3>(3 * a).transpose();
      p_.row(v) = first.segment<3>(3 * a).transpose();
      l_.row(v) = s.segment<3>(3 * a).transpose();
    }
    slope_ = -before.dot(x);
    return definite;
  }

  double nearness(Index v) const { return 1.0 / (1.0 + hops_[static_cast<std::size_t>(v)]); }
  double fullness(Index v) const { return static_cast<double>(near_[static_cast<std::size_t>(v)].size()) / 14 - 1; }
  double log_modulus(Index v) const {
    return 0.5 * std::log(body_.youngs_modulus[v] * body_.dt * body_.dt / (body_.density[v] * length_ * length_));
  }

  // Means over the neighbours minus the vertex's own.
  Positions means(const Positions& vectors) const {
    Positions result = -vectors;
    for (const Index v : free_) {
      for (const Index other : near_[static_cast<std::size_t>(v)]) {
        result.row(v) += vectors.row(other) / static_cast<double>(near_[static_cast<std::size_t>(v)].size());
      }
    }
    return result;
  }

  template <typename Scalars>
  Positions guided(const Guide& guide, const std::vector<Positions>& vectors, const Scalars& scalars) const {
    Positions steps = Positions::Zero(z_.rows(), 3);
    for (const Index v : free_) {
      double square = 1e-18;
      for (const Positions& vector : vectors) square += vector.row(v).squaredNorm();
      std::vector<double> inputs;
      for (std::size_t a = 0; a < vectors.size(); ++a) {
        for (std::size_t b = a; b < vectors.size(); ++b) {
          const double product = vectors[a].row(v).dot(vectors[b].row(v));
          const double root = std::sqrt(std::abs(product) / square + 1e-9);
          inputs.push_back(product > 0 ? root : product < 0 ? -root : 0.0);
        }
      }
      inputs.push_back(0.125 * std::clamp(std::log(square), -24.0, 6.0) + 0.75);
      for (const double scalar : scalars(v)) inputs.push_back(scalar);
      Vector h = Eigen::Map<const Vector>(inputs.data(), static_cast<Eigen::Index>(inputs.size()));
      for (std::size_t k = 0; k < guide.size(); ++k) {
        h = guide[k].weight.cast<double>() * h + guide[k].bias.cast<double>();
        if (k + 1 < guide.size()) h = h.array().tanh().matrix();
      }
      for (std::size_t k = 0; k < vectors.size(); ++k) steps.row(v) += h[static_cast<Eigen::Index>(k)] * vectors[k].row(v);
    }
    return steps;
  }

  NewtonSchedule schedule_;
  NewtonBody body_;
  double length_ = 0;
  std::vector<Tet> tets_;
  Eigen::MatrixXd masses_, tangent_;
  Vector lumped_, pins_;
  std::vector<std::set<Index>> near_;
  std::vector<Index> free_;
  std::vector<int> hops_;
  std::vector<Positions> u_;  // u(t) to u(t-3), x(t) to x(t-2)
  Positions y_, z_, x1_, gradient_, g_, p_, l_;
  double energy_ = 0, left_ = 0, slope_ = 0;
  bool slow_ = false;  // a step of the frame left more than half of the residual
  bool guides_ = true, exact_ = false, directions_exact_ = true;
  int steps_ = 0, taken_ = 0;  // of the frame; iterations of the last direction
  double rate_ = 0;
};

}  // namespace followthrough
