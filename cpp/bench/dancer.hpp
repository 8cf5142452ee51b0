// SPDX-License-Identifier: GPL-3.0-or-later
/// @file
/// A plump figure of capsules in a grid of tets, and a dance: swings, bends, a fast turn, two jumps and a sudden stop. Vertices
/// near the bones are constrained to them.
#pragma once

#include <Eigen/Geometry>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <vector>

#include "followthrough/types.hpp"

namespace followthrough {

class Dancer {
 public:
  static constexpr double dt = 0.0316227766016838;  // s; with 1000 kg/m3, dt^2 / density = 1e-6
  static constexpr int frames = 240;

  /// @param edge of the grid's cubes, m; the figure is 5 m tall, 0.2 gives about 1,500 vertices
  explicit Dancer(double edge);

  Positions rest;
  Tets tets;
  Mask constrained;

  /// @return (n,3) skinned positions of a frame
  Positions reference(int frame) const;

 private:
  using Vec = Eigen::Vector3d;
  struct Bone {
    int parent;
    Vec head, tail;
    double radius;
  };
  static constexpr int bone_count = 11;
  static const std::array<Bone, bone_count>& bones();
  static std::array<Eigen::Affine3d, bone_count> pose(int frame);
  Eigen::Matrix<double, Eigen::Dynamic, bone_count> weights_;
};

inline const std::array<Dancer::Bone, Dancer::bone_count>& Dancer::bones() {
  static const std::array<Bone, bone_count> all = {{
      {-1, {0, 0, 2.45}, {0, 0, 2.9}, 0.62},  // 0 hips
      {0, {0, 0, 2.9}, {0, 0, 3.75}, 0.66},   // 1 chest
      {1, {0, 0, 4.1}, {0, 0, 4.55}, 0.45},   // 2 head
      {1, {0.55, 0, 3.85}, {1.25, 0, 3.75}, 0.3},
      {3, {1.25, 0, 3.75}, {2.0, 0, 3.7}, 0.26},  // 3, 4 left arm
      {1, {-0.55, 0, 3.85}, {-1.25, 0, 3.75}, 0.3},
      {5, {-1.25, 0, 3.75}, {-2.0, 0, 3.7}, 0.26},  // 5, 6 right arm
      {0, {0.42, 0, 2.3}, {0.48, 0, 1.3}, 0.42},
      {7, {0.48, 0, 1.3}, {0.5, 0, 0.3}, 0.32},  // 7, 8 left leg
      {0, {-0.42, 0, 2.3}, {-0.48, 0, 1.3}, 0.42},
      {9, {-0.48, 0, 1.3}, {-0.5, 0, 0.3}, 0.32},  // 9, 10 right leg
  }};
  return all;
}

inline Dancer::Dancer(double edge) {
  const auto distance = [](const Bone& bone, const Vec& p) {
    const Vec along = bone.tail - bone.head;
    const double t = std::clamp((p - bone.head).dot(along) / along.squaredNorm(), 0.0, 1.0);
    return (p - bone.head - t * along).norm();
  };
  const auto inside = [&](const Vec& p) {
    return std::any_of(bones().begin(), bones().end(), [&](const Bone& bone) { return distance(bone, p) < bone.radius; });
  };
  const std::array<std::array<int, 4>, 6> cube = {
      {{0, 4, 2, 1}, {4, 2, 1, 5}, {2, 1, 5, 3}, {4, 6, 2, 5}, {6, 5, 7, 3}, {6, 2, 5, 3}}};  // bits: x y z
  const auto half = static_cast<int>(2.5 / edge) + 1;
  std::map<std::array<int, 3>, Index> vertex_at;
  std::vector<std::array<int, 3>> cells;
  for (int x = -half; x < half; ++x) {
    for (int y = -half; y < half; ++y) {
      for (int z = 0; z < 2 * half; ++z) {
        if (inside(edge * Vec(x + 0.5, y + 0.5, z + 0.5))) cells.push_back({x, y, z});
      }
    }
  }
  for (const auto& [x, y, z] : cells) {
    for (int c = 0; c < 8; ++c) vertex_at[{x + (c >> 2), y + (c >> 1 & 1), z + (c & 1)}] = 0;
  }
  rest.resize(static_cast<Eigen::Index>(vertex_at.size()), 3);
  Index count = 0;
  for (auto& [at, vertex] : vertex_at) {
    rest.row(count) << edge * at[0], edge * at[1], edge * at[2];
    vertex = count++;
  }
  tets.resize(static_cast<Eigen::Index>(6 * cells.size()), 4);
  Eigen::Index tet = 0;
  for (const auto& [x, y, z] : cells) {
    for (const auto& corners : cube) {
      for (int k = 0; k < 4; ++k) {
        const int c = corners[k];
        tets(tet, k) = vertex_at.at({x + (c >> 2), y + (c >> 1 & 1), z + (c & 1)});
      }
      ++tet;
    }
  }
  weights_.resize(count, bone_count);
  constrained.resize(count);
  for (Index v = 0; v < count; ++v) {
    const Vec p = rest.row(v).transpose();
    constrained[v] = false;
    for (int b = 0; b < bone_count; ++b) {
      const Bone& bone = bones()[b];
      const double near = distance(bone, p) / bone.radius;
      weights_(v, b) = std::pow(near + 0.1, -6);
      constrained[v] = constrained[v] || near < 0.4;
    }
    weights_.row(v) /= weights_.row(v).sum();
  }
}

inline std::array<Eigen::Affine3d, Dancer::bone_count> Dancer::pose(int frame) {
  using Eigen::AngleAxisd;
  constexpr double pi = std::numbers::pi;
  const double stop = 5.2;
  const double t = std::min(frame * dt, stop);
  const double fade = std::clamp(t / 0.4, 0.0, 1.0);
  const double beat = 2 * pi * 1.1 * t;
  const auto ease = [](double from, double to, double at) {
    const double s = std::clamp((at - from) / (to - from), 0.0, 1.0);
    return s * s * (3 - 2 * s);
  };
  const auto hop = [&](double start, double length, double height) {
    const double s = (t - start) / length;
    return s > 0 && s < 1 ? 4 * height * s * (1 - s) : 0.0;
  };
  std::array<Eigen::Matrix3d, bone_count> turn;
  turn.fill(Eigen::Matrix3d::Identity());
  const auto about = [](double angle, const Vec& axis) { return AngleAxisd(angle, axis).toRotationMatrix(); };
  const Vec x = Vec::UnitX(), y = Vec::UnitY(), z = Vec::UnitZ();
  const double spin = 2 * pi * (ease(1.9, 2.5, t) - ease(4.1, 4.6, t));
  turn[0] = about(spin + 0.3 * fade * std::sin(beat / 2), z) * about(0.15 * fade * std::sin(beat), y);
  turn[1] = about(0.3 * fade * std::sin(beat), y) * about(0.25 * fade * std::sin(2 * beat), x);
  turn[2] = about(0.4 * fade * std::sin(beat + 0.5), z) * about(0.25 * fade * std::sin(2 * beat), x);
  for (const int side : {1, -1}) {
    const int arm = side > 0 ? 3 : 5, leg = side > 0 ? 7 : 9;
    turn[arm] = about(side * fade * (-0.3 + 0.7 * std::sin(beat)), y) * about(0.6 * fade * std::cos(beat), z);
    turn[arm + 1] = about(-side * fade * (0.7 + 0.6 * std::sin(beat + 0.7)), y) * about(side * 0.5 * fade * std::sin(2 * beat), z);
    const double crouch = hop(2.75, 0.25, 0.5) + hop(3.65, 0.2, 0.5);
    turn[leg] = about(-0.7 * fade * std::max(0.0, side * std::sin(beat / 2)) - crouch, x);
    turn[leg + 1] = about(1.0 * fade * std::max(0.0, side * std::sin(beat / 2)) + 1.8 * crouch, x);
  }
  Eigen::Affine3d root = Eigen::Affine3d::Identity();
  root.translate(Vec(0.5 * fade * std::sin(beat / 2), 0.3 * fade * std::sin(beat / 4),
                     hop(2.95, 0.7, 1.2) + hop(3.8, 0.5, 0.6) - 0.12 * fade * std::abs(std::sin(beat))));
  std::array<Eigen::Affine3d, bone_count> poses;
  for (int b = 0; b < bone_count; ++b) {
    const Bone& bone = bones()[b];
    poses[b] = (bone.parent < 0 ? root : poses[bone.parent]) * Eigen::Translation3d(bone.head) * Eigen::Affine3d(turn[b]) *
               Eigen::Translation3d(-bone.head);
  }
  return poses;
}

inline Positions Dancer::reference(int frame) const {
  const auto poses = pose(frame);
  Positions moved = Positions::Zero(rest.rows(), 3);
  for (int b = 0; b < bone_count; ++b) {
    const Positions rigid =
        (rest * poses[b].linear().transpose()).rowwise() + Eigen::RowVector3d(poses[b].translation().transpose());
    moved += weights_.col(b).asDiagonal() * rigid;
  }
  return moved;
}

}  // namespace followthrough
