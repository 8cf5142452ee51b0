// SPDX-License-Identifier: GPL-3.0-or-later
// Sums over bones and corners go vertex by vertex, a row in a few registers; the rest goes number by number, many vertices in one
// register. Neither depends on a register's width, so all instruction sets give the same bits.
#include "motion/surface_offsets.hpp"

#include "skinning/bone_rows_sum.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

constexpr int block_size = 64;  // vertices: their numbers stay in the first-level cache
constexpr int group = 8;        // what is computed at once is a multiple of it

/// Vertices that move, and what is known of them: every number of all of them in a row.
struct Block {
  int count;
  std::int32_t vertices[block_size];
  double displacement[3][block_size];
  double jacobian[9][block_size];
  double offset[3][block_size];
  double slack[block_size];  ///< above 0: proof that no stretch has to be clamped (see stretch_solve)
  double displacement_squared[block_size];
  double residual_squared[block_size];
};

/// Writes three numbers to a row of a table; returns whether they are finite there.
template <typename Number>
bool write(Number* table, std::int64_t row, double x, double y, double z) {
  Number* out = table + 3 * row;
  out[0] = static_cast<Number>(x), out[1] = static_cast<Number>(y), out[2] = static_cast<Number>(z);
  const Number zero = (out[0] - out[0]) + (out[1] - out[1]) + (out[2] - out[2]);
  return zero == Number(0);
}

bool write_offset(const SurfaceFrame& frame, std::int64_t vertex, double x, double y, double z) {
  return frame.rounded ? write(frame.rounded, vertex, x, y, z) : write(frame.offsets, vertex, x, y, z);
}

/// Adds a vertex that does not move exactly as its bones do; returns false where its weights cannot be used.
bool gather(const SurfaceFrame& frame, std::int64_t vertex, Block& block) {
  const std::int32_t* corners = frame.corners + 4 * vertex;
  const double* weights = frame.embedding_weights + 4 * vertex;
  double moved[4];
  for (int part = 0; part < 4; part += lanes) {
    Lanes sum = weights[0] * load(frame.moved + 4 * static_cast<std::int64_t>(corners[0]) + part);
    for (int k = 1; k < 4; ++k) sum += weights[k] * load(frame.moved + 4 * static_cast<std::int64_t>(corners[k]) + part);
    store(moved + part, sum);
  }
  if (!frame.rounded) write(frame.displacements, vertex, moved[0], moved[1], moved[2]);
  if (moved[0] == 0.0 && moved[1] == 0.0 && moved[2] == 0.0) {  // pinned: most of a character
    return write_offset(frame, vertex, 0.0, 0.0, 0.0);
  }
  BoneRows rows = frame.bones;
  rows.indices += vertex * rows.places;
  rows.weights += vertex * rows.places;
  double sum[12];
  bool valid = true;
  const double total = sum_rows<12, false>(rows, sum, valid);
  const bool held = total > frame.least_total_weight;
  const double share = held ? 1.0 / total : 0.0;
  const int place = block.count++;
  block.vertices[place] = static_cast<std::int32_t>(vertex);
  for (int axis = 0; axis < 3; ++axis) block.displacement[axis][place] = moved[axis];
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 3; ++column) {
      block.jacobian[3 * row + column][place] = held ? share * sum[4 * row + column] : (row == column ? 1.0 : 0.0);
    }
  }
  return valid;
}

/// Makes the block's length a multiple of a group.
int fill_up(Block& block) {
  int end = block.count;
  for (; end % group != 0; ++end) {
    for (int axis = 0; axis < 3; ++axis) block.displacement[axis][end] = 0.0;
    for (int k = 0; k < 9; ++k) block.jacobian[k][end] = k % 4 == 0 ? 1.0 : 0.0;
  }
  return end;
}

/// `stretch_solve` for a whole block, by Cramer's rule.
void solve(const SurfaceFrame& frame, Block& block, int end) {
  double o[9], w[9];  // copies, which nothing that is written can change
  for (int k = 0; k < 9; ++k) o[k] = frame.to_object[k], w[k] = frame.to_world[k];
  const double limit = 1.0001 * frame.minimum_stretch;
  const auto& j = block.jacobian;
  for (int i = 0; i < end; ++i) {
    const double dx = block.displacement[0][i], dy = block.displacement[1][i], dz = block.displacement[2][i];
    const double a = o[0] * dx + o[1] * dy + o[2] * dz;
    const double b = o[3] * dx + o[4] * dy + o[5] * dz;
    const double c = o[6] * dx + o[7] * dy + o[8] * dz;
    const double j0 = j[0][i], j1 = j[1][i], j2 = j[2][i];
    const double j3 = j[3][i], j4 = j[4][i], j5 = j[5][i];
    const double j6 = j[6][i], j7 = j[7][i], j8 = j[8][i];
    // Cross products of the columns: rows of the adjugate.
    const double yz0 = j4 * j8 - j7 * j5, yz1 = j7 * j2 - j1 * j8, yz2 = j1 * j5 - j4 * j2;
    const double zx0 = j5 * j6 - j8 * j3, zx1 = j8 * j0 - j2 * j6, zx2 = j2 * j3 - j5 * j0;
    const double xy0 = j3 * j7 - j6 * j4, xy1 = j6 * j1 - j0 * j7, xy2 = j0 * j4 - j3 * j1;
    const double determinant = j0 * yz0 + j3 * yz1 + j6 * yz2;
    const double square = ((j0 * j0 + j1 * j1) + (j2 * j2 + j3 * j3)) + ((j4 * j4 + j5 * j5) + (j6 * j6 + j7 * j7)) + j8 * j8;
    const double size = determinant < 0.0 ? -determinant : determinant;
    block.slack[i] = 2.0 * size - limit * square;
    const double inverse = 1.0 / determinant;
    const double x = (yz0 * a + yz1 * b + yz2 * c) * inverse;
    const double y = (zx0 * a + zx1 * b + zx2 * c) * inverse;
    const double z = (xy0 * a + xy1 * b + xy2 * c) * inverse;
    block.offset[0][i] = x;
    block.offset[1][i] = y;
    block.offset[2][i] = z;
    block.displacement_squared[i] = dx * dx + dy * dy + dz * dz;
    const double ra = a - (j0 * x + j1 * y + j2 * z);
    const double rb = b - (j3 * x + j4 * y + j5 * z);
    const double rc = c - (j6 * x + j7 * y + j8 * z);
    const double rx = w[0] * ra + w[1] * rb + w[2] * rc;
    const double ry = w[3] * ra + w[4] * rb + w[5] * rc;
    const double rz = w[6] * ra + w[7] * rb + w[8] * rc;
    block.residual_squared[i] = rx * rx + ry * ry + rz * rz;
  }
}

void scatter(const SurfaceFrame& frame, const Block& block, std::int32_t* flattened, SurfaceShare& share) {
  for (int i = 0; i < block.count; ++i) {
    if (block.displacement_squared[i] > share.displacement_squared) share.displacement_squared = block.displacement_squared[i];
    if (!(block.slack[i] > 0.0)) {
      flattened[share.flattened++] = block.vertices[i];
      continue;
    }
    if (block.residual_squared[i] > share.residual_squared) share.residual_squared = block.residual_squared[i];
    share.usable &= write_offset(frame, block.vertices[i], block.offset[0][i], block.offset[1][i], block.offset[2][i]);
  }
}

}  // namespace

SurfaceShare surface_offsets(const SurfaceFrame& frame, std::int64_t first, std::int64_t last, std::int32_t* flattened) noexcept {
  SurfaceShare share;
  Block block;
  for (std::int64_t vertex = first; vertex < last;) {
    block.count = 0;
    for (; vertex < last && block.count < block_size; ++vertex) share.usable &= gather(frame, vertex, block);
    solve(frame, block, fill_up(block));
    scatter(frame, block, flattened, share);
  }
  return share;
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
