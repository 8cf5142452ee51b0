// SPDX-License-Identifier: GPL-3.0-or-later
// Closest points and winding numbers of a triangle surface through one tree of boxes. Far away groups of triangles count as one
// dipole [Barill et al. 2018, "Fast winding numbers for soups and clouds"].
#pragma once

#include <vector>

#include "box_tree.hpp"
#include "followthrough/types.hpp"

namespace followthrough {

struct ClosestPoint {
  Index triangle = -1;
  Eigen::Vector3d barycentric = Eigen::Vector3d::Zero();
  double squared_distance = 0;
};

/// Closest point of one triangle, degenerate ones included.
ClosestPoint closest_on_triangle(const Eigen::Vector3d& p, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
                                 const Eigen::Vector3d& c);

class TriangleTree {
 public:
  /// Keeps copies of both arrays. There must be one triangle at least for `closest`.
  TriangleTree(ConstPositions vertices, ConstTriangles triangles);

  ClosestPoint closest(const Eigen::Vector3d& point) const;

  /// @param opening groups of triangles farther away than so many of their radii count as one dipole; infinity: none does, exact
  double winding_number(const Eigen::Vector3d& point, double opening) const;

  /// The same to the side of `threshold` where it truly lies, but not more exact than that needs.
  double winding_number_near(const Eigen::Vector3d& point, double threshold) const;

  const BoxTree& boxes() const noexcept { return tree_; }
  const Positions& vertices() const noexcept { return vertices_; }
  const Triangles& triangles() const noexcept { return triangles_; }

 private:
  struct Dipole {
    Eigen::Vector3d centre;
    Eigen::Vector3d area;
    double radius;
    Index right;  // of the node, once more
  };

  Eigen::Vector3d corner(Index triangle, int k) const { return vertices_.row(triangles_(triangle, k)); }

  Positions vertices_;
  Triangles triangles_;
  BoxTree tree_;
  std::vector<Dipole> dipoles_;  // one a node of the tree
};

}  // namespace followthrough
