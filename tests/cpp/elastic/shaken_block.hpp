// SPDX-License-Identifier: GPL-3.0-or-later
// A block of flesh that is held and shaken at one side.
#pragma once

#include <cmath>

#include "elastic/blocks.hpp"
#include "followthrough/elastic/elastic_body.hpp"

namespace followthrough {

struct ShakenBlock {
  TetBlock block = tet_block(4, 2, 2, 0.2);
  Vector youngs_modulus = Vector::LinSpaced(block.vertices.rows(), 2e4, 2e5);
  Vector density = Vector::LinSpaced(block.vertices.rows(), 800.0, 1200.0);
  ElasticBody body{block.vertices, block.tets, {youngs_modulus, density}};
  Mask constrained = block.vertices.col(0).array() < 0.1;

  Eigen::Index count() const { return block.vertices.rows(); }

  Positions reference(int frame) const {
    Positions positions = block.vertices;
    positions.col(1).array() += 0.15 * std::sin(0.9 * frame);
    positions.col(2).array() += 0.1 * std::sin(0.5 * frame) * block.vertices.col(0).array();
    return positions;
  }
};

}  // namespace followthrough
