// SPDX-License-Identifier: GPL-3.0-or-later
// Products are rounded before they are added, fused nowhere, so that all instruction sets give the same bits.
#include "elastic/rotation_rows.hpp"

#include "block_lanes.hpp"
#include "lane_algebra.hpp"

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

static_assert(kGroup == rotation_lanes);

constexpr int most_iterations = 8;
// Square of the change below which the rotation counts as found: a few units of the last place.
constexpr float small_change = 1e-12f;
// Share of the cube of its size below which a map's determinant counts as none.
constexpr float smallest_determinant = 1e-6f;

inline Real sum_of_squares(const Square& m) {
  return sum_of_products(m.x, m.x) + sum_of_products(m.y, m.y) + sum_of_products(m.z, m.z);
}
inline Square operator+(const Square& a, const Square& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Square operator-(const Square& a, const Square& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Square operator*(const Square& a, Real s) { return {a.x * s, a.y * s, a.z * s}; }

// Higham's Newton iteration, scaled [N. Higham, Computing the polar decomposition, 1986]: X becomes the mean of itself and its
// inverse transpose.
inline Square nearest_rotation(const Square& map) {
  const Real zero = real(0.0f), one = real(1.0f), half = real(0.5f);
  const Square identity{{one, zero, zero}, {zero, one, zero}, {zero, zero, one}};
  const Real square = sum_of_squares(map);
  Square x = map * (one / root(choose(zero < square, square, one)));
  const LaneMask valid = real(smallest_determinant) < sum_of_products(x.x, cofactors(x).x);
  x = choose(valid, x, identity);
  for (int iteration = 0; iteration < most_iterations; ++iteration) {
    const Square turned = cofactors(x);
    const Square inverse = turned * (one / sum_of_products(x.x, turned.x));
    const Real scale = root(root(sum_of_squares(inverse) / sum_of_squares(x)));
    const Square next = (x * scale + inverse * (one / scale)) * half;
    // What is found stays, so that a lane does not depend on those beside it.
    const LaneMask moves = real(small_change) < sum_of_squares(next - x);
    x = choose(moves, next, x);
    if (bits_of(moves) == 0) break;
  }
  return x;
}

}  // namespace

void turn_rotation_rows(const RotationRows& rows, const float* from, const float* to, float* values, std::int32_t first,
                        std::int32_t last) noexcept {
  const Real zero = real(0.0f);
  for (std::int64_t group = first; group < last; ++group) {
    for (int lane = 0; lane < kGroup; lane += kLanes) {
      const std::int32_t* const own = rows.own + group * kGroup + lane;
      const Triple before = gather_triple(from, own), after = gather_triple(to, own), none{zero, zero, zero};
      Square map{none, none, none};
      for (std::int64_t slot = rows.slot_starts[group]; slot < rows.slot_starts[group + 1]; ++slot) {
        const std::int32_t* const neighbours = rows.neighbours + slot * kGroup + lane;
        const Triple edge = gather_triple(from, neighbours) - before, turned = gather_triple(to, neighbours) - after;
        map = map + Square{edge * turned.x, edge * turned.y, edge * turned.z};
      }
      const Square rotation = nearest_rotation(map);
      float* const at = values + 4 * (group * kGroup + lane);
      Lanes components[3];
      load_vectors(at, components);
      const Triple value{{components[0]}, {components[1]}, {components[2]}};
      store_vectors(
          at, {sum_of_products(rotation.x, value).v, sum_of_products(rotation.y, value).v, sum_of_products(rotation.z, value).v});
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
