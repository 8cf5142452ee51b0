// SPDX-License-Identifier: GPL-3.0-or-later
// Every lane goes through the same operations in the same order, so all instruction sets give the same bits. F is the deformation
// gradient, E = (F^T F - 1) / 2, S = 2 mu E + lambda tr(E) 1, A the cofactors of F, J its determinant, g a corner's gradient:
// P = F S + pressure A, and the stiffness between corners a and b is (g_a . S g_b) 1 + mu ((g_a . g_b) F F^T + F g_b (F g_a)^T) +
// lambda F g_a (F g_b)^T + bulk A g_a (A g_b)^T + pressure [y -> y x F (g_a x g_b)], all times the volume. The first and the last
// term can be negative: where a convex stiffness is asked for the last one is left out, and the first where S is not positive.
#include "elastic/element_batch.hpp"

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors wider than the registers never leave this file
#endif

#if defined(__GNUC__) || defined(__clang__)
#define FOLLOWTHROUGH_VECTORS
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// All lanes in one go where the compiler knows vectors, one after the other elsewhere.
#ifdef FOLLOWTHROUGH_VECTORS
typedef double Number __attribute__((vector_size(sizeof(double) * batch_lanes)));
#else
using Number = double;
#endif
constexpr int lanes_at_once = sizeof(Number) / sizeof(double);

struct Vector {
  Number x, y, z;
};
// A row each.
struct Matrix {
  Vector x, y, z;
};

inline Number load(const double* from) noexcept { return *reinterpret_cast<const Number*>(from); }
inline void store(const Number& value, double* to) noexcept { *reinterpret_cast<Number*>(to) = value; }
inline Vector load(const double (*from)[batch_lanes], int lane) noexcept {
  return {load(from[0] + lane), load(from[1] + lane), load(from[2] + lane)};
}
inline Matrix load_matrix(const double (*from)[batch_lanes], int lane) noexcept {
  return {load(from, lane), load(from + 3, lane), load(from + 6, lane)};
}
inline void store(const Vector& v, double (*to)[batch_lanes], int lane) noexcept {
  store(v.x, to[0] + lane);
  store(v.y, to[1] + lane);
  store(v.z, to[2] + lane);
}

inline Number dot(const Vector& a, const Vector& b) noexcept { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(const Vector& a, const Vector& b) noexcept {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline Vector times(const Vector& a, const Number& s) noexcept { return {a.x * s, a.y * s, a.z * s}; }
inline Vector sum(const Vector& a, const Vector& b) noexcept { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector product(const Matrix& m, const Vector& v) noexcept { return {dot(m.x, v), dot(m.y, v), dot(m.z, v)}; }
// Row vector times matrix.
inline Vector product(const Vector& v, const Matrix& m) noexcept {
  return sum(sum(times(m.x, v.x), times(m.y, v.y)), times(m.z, v.z));
}
inline Matrix product(const Matrix& a, const Matrix& b) noexcept { return {product(a.x, b), product(a.y, b), product(a.z, b)}; }

// What forces and stiffness have in common.
struct Strain {
  Matrix f, s, cofactors;
  Number pressure, bulk;
};

inline Strain strain(const BatchConstants& k, ElementBatch& b, int lane, double smallest_stretch) noexcept {
  Strain r;
  r.f = product(load_matrix(b.edges, lane), load_matrix(k.gradients, lane));
  const Matrix& f = r.f;
  r.cofactors = {cross(f.y, f.z), cross(f.z, f.x), cross(f.x, f.y)};
  const Number volume = dot(f.x, r.cofactors.x);
  const Number xx = f.x.x * f.x.x + f.y.x * f.y.x + f.z.x * f.z.x, yy = f.x.y * f.x.y + f.y.y * f.y.y + f.z.y * f.z.y;
  const Number zz = f.x.z * f.x.z + f.y.z * f.y.z + f.z.z * f.z.z, xy = f.x.x * f.x.y + f.y.x * f.y.y + f.z.x * f.z.y;
  const Number xz = f.x.x * f.x.z + f.y.x * f.y.z + f.z.x * f.z.z, yz = f.x.y * f.x.z + f.y.y * f.y.z + f.z.y * f.z.z;
  // All stretches are above the clamp where F^T F - clamp^2 is positive definite and F is not inverted.
  const double square = smallest_stretch * smallest_stretch;
  const Number cx = xx - square, cy = yy - square, cz = zz - square;
  const Number minor = cx * cy - xy * xy;
  const Number determinant = cz * minor + 2.0 * (xy * xz * yz) - cx * (yz * yz) - cy * (xz * xz);
  const Number none = volume - volume;
  const Number inside = (cx > 0.0) & (minor > 0.0) & (determinant > 0.0) & (volume > 0.0) ? none + 1.0 : none;
  store(inside, b.inside + lane);

  const Number mu = load(k.mu + lane), lambda = load(k.lambda + lane), resistance = load(k.compression_resistance + lane);
  const Number ex = 0.5 * (xx - 1.0), ey = 0.5 * (yy - 1.0), ez = 0.5 * (zz - 1.0);
  const Number trace = ex + ey + ez, tension = lambda * trace, twice = 2.0 * mu;
  r.s = {
      {twice * ex + tension, mu * xy, mu * xz}, {mu * xy, twice * ey + tension, mu * yz}, {mu * xz, mu * yz, twice * ez + tension}};
  const Number gap = 1.0 - volume;
  const Number squeeze = gap > 0.0 ? gap : none;
  r.pressure = resistance * squeeze * squeeze * (-1.0 / 576.0);
  r.bulk = resistance * squeeze * (1.0 / 288.0);
  const Number shear = xy * xy + xz * xz + yz * yz;
  const Number density = mu * (ex * ex + ey * ey + ez * ez + 0.5 * shear) + 0.5 * tension * trace +
                         resistance * squeeze * squeeze * squeeze * (1.0 / 1728.0);
  store(load(k.volume + lane) * density, b.energy + lane);
  return r;
}

// 1 where a symmetric matrix is positive definite, 0 elsewhere.
inline Number share_of_stress(const Matrix& s) noexcept {
  const Number minor = s.x.x * s.y.y - s.x.y * s.x.y;
  const Number none = minor - minor;
  return (s.x.x > 0.0) & (minor > 0.0) & (dot(s.x, cross(s.y, s.z)) > 0.0) ? none + 1.0 : none;
}

// A row of a stiffness block: rows of the terms named at the top.
inline Vector block_row(const Number& near, const Vector& left, const Number& by_a, const Vector& moved_a, const Number& by_c,
                        const Vector& moved_c, const Number& by_normal, const Vector& normal_c) noexcept {
  return sum(sum(times(left, near), times(moved_a, by_c)), sum(times(moved_c, by_a), times(normal_c, by_normal)));
}

}  // namespace

void batch_forces(const BatchConstants& k, ElementBatch& b, double smallest_stretch) noexcept {
  for (int lane = 0; lane < batch_lanes; lane += lanes_at_once) {
    const Strain r = strain(k, b, lane, smallest_stretch);
    const Matrix g = load_matrix(k.gradients, lane);
    const Number volume = load(k.volume + lane);
    const Vector* f[] = {&r.f.x, &r.f.y, &r.f.z};
    const Vector* a[] = {&r.cofactors.x, &r.cofactors.y, &r.cofactors.z};
    for (int i = 0; i < 3; ++i) {
      const Vector stress = times(sum(product(*f[i], r.s), times(*a[i], r.pressure)), volume);
      store(product(g, stress), b.forces + 3 * i, lane);
    }
  }
}

void batch_stiffness(const BatchConstants& k, ElementBatch& b, double smallest_stretch, bool convex) noexcept {
  for (int lane = 0; lane < batch_lanes; lane += lanes_at_once) {
    const Strain r = strain(k, b, lane, smallest_stretch);
    const Number v = load(k.volume + lane), mu = v * load(k.mu + lane), lambda = v * load(k.lambda + lane);
    const Number bulk = v * r.bulk, pressure = convex ? v - v : v * r.pressure;
    const Number keep = convex ? share_of_stress(r.s) : v - v + 1.0;
    const Matrix left = {product(r.f, r.f.x), product(r.f, r.f.y), product(r.f, r.f.z)};  // F F^T
    Vector g[3], moved[3], normal[3], pulled[3];                                          // a corner each: g, F g, A g, S g
    for (int a = 0; a < 3; ++a) {
      g[a] = load(k.gradients + 3 * a, lane);
      moved[a] = product(r.f, g[a]);
      normal[a] = product(r.cofactors, g[a]);
      pulled[a] = product(r.s, g[a]);
    }
    int pair = 0;
    for (int a = 0; a < 3; ++a) {
      for (int c = a; c < 3; ++c) {
        const Number pull = v * keep * dot(g[a], pulled[c]), near = mu * dot(g[a], g[c]);
        const Vector axis = times(product(r.f, cross(g[a], g[c])), pressure);
        const Vector by_a = times(moved[a], lambda), by_c = times(moved[c], mu), by_normal = times(normal[a], bulk);
        Vector x = block_row(near, left.x, by_a.x, moved[a], by_c.x, moved[c], by_normal.x, normal[c]);
        Vector y = block_row(near, left.y, by_a.y, moved[a], by_c.y, moved[c], by_normal.y, normal[c]);
        Vector z = block_row(near, left.z, by_a.z, moved[a], by_c.z, moved[c], by_normal.z, normal[c]);
        x = {x.x + pull, x.y + axis.z, x.z - axis.y};
        y = {y.x - axis.z, y.y + pull, y.z + axis.x};
        z = {z.x + axis.y, z.y - axis.x, z.z + pull};
        store(x, b.blocks[pair], lane);
        store(y, b.blocks[pair] + 3, lane);
        store(z, b.blocks[pair] + 6, lane);
        ++pair;
      }
    }
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
