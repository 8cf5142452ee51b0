// SPDX-License-Identifier: GPL-3.0-or-later
// Every lane goes through the same operations in the same order, so all instruction sets give the same bits. F is the deformation
// gradient, E = (F^T F - 1) / 2, S = 2 mu E + lambda tr(E) 1, A the cofactors of F, J its determinant, g a corner's gradient:
// P = F S + pressure A, and the stiffness between corners a and b is (g_a . S g_b) 1 + mu ((g_a . g_b) F F^T + F g_b (F g_a)^T) +
// lambda F g_a (F g_b)^T + bulk A g_a (A g_b)^T + pressure [y -> y x F (g_a x g_b)], all times the volume. The first and the last
// term can be negative: where a convex stiffness is asked for the last one is left out, and the first where S is not positive.
#include "elastic/element_batch.hpp"

#include <cstring>

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors wider than the registers never leave this file
#endif

#if defined(__GNUC__) || defined(__clang__)
#define FOLLOWTHROUGH_VECTORS
#define FOLLOWTHROUGH_INLINE inline __attribute__((always_inline))  // through memory the vectors would take longer
#ifdef __has_builtin
#if __has_builtin(__builtin_shufflevector) && (defined(__AVX__) || defined(__aarch64__))
#define FOLLOWTHROUGH_SHUFFLES
#endif
#endif
#else
#define FOLLOWTHROUGH_INLINE inline
#endif

namespace followthrough::FOLLOWTHROUGH_ISA {
namespace {

// As many lanes in one go as a register has where the compiler knows vectors, one after the other elsewhere. A vertex is four
// numbers, one of them unused.
#ifdef FOLLOWTHROUGH_VECTORS
#if defined(__AVX512F__)
#define FOLLOWTHROUGH_REGISTER 64
#elif defined(FOLLOWTHROUGH_SHUFFLES)
#define FOLLOWTHROUGH_REGISTER 32
#else
#define FOLLOWTHROUGH_REGISTER 16
#endif
typedef double Doubles __attribute__((vector_size(FOLLOWTHROUGH_REGISTER)));
typedef float Singles __attribute__((vector_size(FOLLOWTHROUGH_REGISTER)));
typedef double FourDoubles __attribute__((vector_size(4 * sizeof(double))));
typedef float FourSingles __attribute__((vector_size(4 * sizeof(float))));
inline FourDoubles minus(const FourDoubles& a, const FourDoubles& b) noexcept { return a - b; }
inline FourSingles single(const FourDoubles& a) noexcept { return __builtin_convertvector(a, FourSingles); }
#else
using Doubles = double;
using Singles = float;
template <typename Real>
struct Four {
  Real values[4];
  Real operator[](int k) const noexcept { return values[k]; }
};
using FourDoubles = Four<double>;
using FourSingles = Four<float>;
template <typename Real>
inline Four<Real> operator+(const Four<Real>& a, const Four<Real>& b) noexcept {
  return {{a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]}};
}
template <typename Real>
inline Four<Real> operator-(const Four<Real>& a, const Four<Real>& b) noexcept {
  return {{a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]}};
}
template <typename Real>
inline Four<Real> operator*(const Four<Real>& a, Real s) noexcept {
  return {{a[0] * s, a[1] * s, a[2] * s, a[3] * s}};
}
inline FourDoubles minus(const FourDoubles& a, const FourDoubles& b) noexcept { return a - b; }
inline FourSingles single(const FourDoubles& a) noexcept {
  return {{static_cast<float>(a[0]), static_cast<float>(a[1]), static_cast<float>(a[2]), static_cast<float>(a[3])}};
}
#endif

template <typename Real>
struct Registers;
template <>
struct Registers<double> {
  using Number = Doubles;
  using Four = FourDoubles;
};
template <>
struct Registers<float> {
  using Number = Singles;
  using Four = FourSingles;
};
template <typename Real>
using NumberOf = typename Registers<Real>::Number;
template <typename Real>
using FourOf = typename Registers<Real>::Four;
template <typename Real>
constexpr int lanes_at_once = sizeof(NumberOf<Real>) / sizeof(Real);

template <typename Number>
struct Vector {
  Number x, y, z;
};
// A row each.
template <typename Number>
struct Matrix {
  Vector<Number> x, y, z;
};

inline Doubles load(const double* from) noexcept { return *reinterpret_cast<const Doubles*>(from); }
inline Singles load(const float* from) noexcept { return *reinterpret_cast<const Singles*>(from); }
inline void store(const Doubles& value, double* to) noexcept { *reinterpret_cast<Doubles*>(to) = value; }
inline void store(const Singles& value, float* to) noexcept { *reinterpret_cast<Singles*>(to) = value; }
template <typename Real, int lanes>
inline Vector<NumberOf<Real>> load(const Real (*from)[lanes], int lane) noexcept {
  return {load(from[0] + lane), load(from[1] + lane), load(from[2] + lane)};
}
template <typename Real, int lanes>
inline Matrix<NumberOf<Real>> load_matrix(const Real (*from)[lanes], int lane) noexcept {
  return {load(from, lane), load(from + 3, lane), load(from + 6, lane)};
}
template <typename Real, int lanes>
inline void store(const Vector<NumberOf<Real>>& v, Real (*to)[lanes], int lane) noexcept {
  store(v.x, to[0] + lane);
  store(v.y, to[1] + lane);
  store(v.z, to[2] + lane);
}

template <typename Number>
inline Number dot(const Vector<Number>& a, const Vector<Number>& b) noexcept {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <typename Number>
inline Vector<Number> cross(const Vector<Number>& a, const Vector<Number>& b) noexcept {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <typename Number>
inline Vector<Number> times(const Vector<Number>& a, const Number& s) noexcept {
  return {a.x * s, a.y * s, a.z * s};
}
template <typename Number>
inline Vector<Number> sum(const Vector<Number>& a, const Vector<Number>& b) noexcept {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <typename Number>
inline Vector<Number> product(const Matrix<Number>& m, const Vector<Number>& v) noexcept {
  return {dot(m.x, v), dot(m.y, v), dot(m.z, v)};
}
// Row vector times matrix.
template <typename Number>
inline Vector<Number> product(const Vector<Number>& v, const Matrix<Number>& m) noexcept {
  return sum(sum(times(m.x, v.x), times(m.y, v.y)), times(m.z, v.z));
}
template <typename Number>
inline Matrix<Number> product(const Matrix<Number>& a, const Matrix<Number>& b) noexcept {
  return {product(a.x, b), product(a.y, b), product(a.z, b)};
}

// What forces and stiffness have in common.
template <typename Number>
struct Strain {
  Matrix<Number> f, s, cofactors;
  Number pressure, bulk;
  Number inside;  // 1 where all stretches are above the clamp
  Number energy;
};

template <typename Constants, typename Real = typename Constants::Real>
FOLLOWTHROUGH_INLINE Strain<NumberOf<Real>> strain(const Constants& k, const Matrix<NumberOf<Real>>& edges, int lane,
                                                   Real smallest_stretch, bool with_energy) noexcept {
  using Number = NumberOf<Real>;
  constexpr Real zero = 0, half = Real(0.5), one = 1, two = 2;
  Strain<Number> r;
  r.f = product(edges, load_matrix(k.gradients, lane));
  const Matrix<Number>& f = r.f;
  r.cofactors = {cross(f.y, f.z), cross(f.z, f.x), cross(f.x, f.y)};
  const Number volume = dot(f.x, r.cofactors.x);
  const Number xx = f.x.x * f.x.x + f.y.x * f.y.x + f.z.x * f.z.x, yy = f.x.y * f.x.y + f.y.y * f.y.y + f.z.y * f.z.y;
  const Number zz = f.x.z * f.x.z + f.y.z * f.y.z + f.z.z * f.z.z, xy = f.x.x * f.x.y + f.y.x * f.y.y + f.z.x * f.z.y;
  const Number xz = f.x.x * f.x.z + f.y.x * f.y.z + f.z.x * f.z.z, yz = f.x.y * f.x.z + f.y.y * f.y.z + f.z.y * f.z.z;
  // All stretches are above the clamp where F^T F - clamp^2 is positive definite and F is not inverted.
  const Real square = smallest_stretch * smallest_stretch;
  const Number cx = xx - square, cy = yy - square, cz = zz - square;
  const Number minor = cx * cy - xy * xy;
  const Number determinant = cz * minor + two * (xy * xz * yz) - cx * (yz * yz) - cy * (xz * xz);
  const Number none = volume - volume;
  r.inside = (cx > zero) & (minor > zero) & (determinant > zero) & (volume > zero) ? none + one : none;

  const Number mu = load(k.mu + lane), lambda = load(k.lambda + lane), resistance = load(k.compression_resistance + lane);
  const Number ex = half * (xx - one), ey = half * (yy - one), ez = half * (zz - one);
  const Number trace = ex + ey + ez, tension = lambda * trace, twice = two * mu;
  r.s = {
      {twice * ex + tension, mu * xy, mu * xz}, {mu * xy, twice * ey + tension, mu * yz}, {mu * xz, mu * yz, twice * ez + tension}};
  const Number gap = one - volume;
  const Number squeeze = gap > zero ? gap : none;
  r.pressure = resistance * squeeze * squeeze * Real(-1.0 / 576.0);
  r.bulk = resistance * squeeze * Real(1.0 / 288.0);
  if (!with_energy) return r;
  const Number shear = xy * xy + xz * xz + yz * yz;
  const Number density = mu * (ex * ex + ey * ey + ez * ez + half * shear) + half * tension * trace +
                         resistance * squeeze * squeeze * squeeze * Real(1.0 / 1728.0);
  r.energy = load(k.volume + lane) * density;
  return r;
}

inline FourDoubles load_four(const double* from) noexcept {
  FourDoubles four;
  std::memcpy(&four, from, sizeof(four));
  return four;
}
inline FourSingles load_four(const float* from) noexcept {
  FourSingles four;
  std::memcpy(&four, from, sizeof(four));
  return four;
}
template <typename Four, typename Real>
inline void store_four(const Four& four, Real* to) noexcept {
  std::memcpy(to, &four, sizeof(four));
}
inline void convert(const FourDoubles& from, FourDoubles& to) noexcept { to = from; }
inline void convert(const FourDoubles& from, FourSingles& to) noexcept { to = single(from); }

// An item a lane becomes a register a coordinate, and back.
#if defined(FOLLOWTHROUGH_SHUFFLES) && FOLLOWTHROUGH_REGISTER == 32
inline Vector<Doubles> coordinates(const FourDoubles (&item)[4]) noexcept {
  const Doubles xz01 = __builtin_shufflevector(item[0], item[1], 0, 4, 2, 6);
  const Doubles xz23 = __builtin_shufflevector(item[2], item[3], 0, 4, 2, 6);
  const Doubles y01 = __builtin_shufflevector(item[0], item[1], 1, 5, 3, 7);
  const Doubles y23 = __builtin_shufflevector(item[2], item[3], 1, 5, 3, 7);
  return {__builtin_shufflevector(xz01, xz23, 0, 1, 4, 5), __builtin_shufflevector(y01, y23, 0, 1, 4, 5),
          __builtin_shufflevector(xz01, xz23, 2, 3, 6, 7)};
}
inline void items(const Vector<Doubles>& v, FourDoubles (&item)[4]) noexcept {
  const Doubles none = v.x - v.x;
  const Doubles xy_even = __builtin_shufflevector(v.x, v.y, 0, 4, 2, 6), xy_odd = __builtin_shufflevector(v.x, v.y, 1, 5, 3, 7);
  const Doubles z_even = __builtin_shufflevector(v.z, none, 0, 4, 2, 6), z_odd = __builtin_shufflevector(v.z, none, 1, 5, 3, 7);
  item[0] = __builtin_shufflevector(xy_even, z_even, 0, 1, 4, 5);
  item[1] = __builtin_shufflevector(xy_odd, z_odd, 0, 1, 4, 5);
  item[2] = __builtin_shufflevector(xy_even, z_even, 2, 3, 6, 7);
  item[3] = __builtin_shufflevector(xy_odd, z_odd, 2, 3, 6, 7);
}
inline Vector<Singles> coordinates(const FourSingles (&item)[8]) noexcept {
  Singles pair[4];  // items k and k + 4
  for (int k = 0; k < 4; ++k) pair[k] = __builtin_shufflevector(item[k], item[k + 4], 0, 1, 2, 3, 4, 5, 6, 7);
  const Singles xy01 = __builtin_shufflevector(pair[0], pair[1], 0, 8, 1, 9, 4, 12, 5, 13);
  const Singles xy23 = __builtin_shufflevector(pair[2], pair[3], 0, 8, 1, 9, 4, 12, 5, 13);
  const Singles z01 = __builtin_shufflevector(pair[0], pair[1], 2, 10, 3, 11, 6, 14, 7, 15);
  const Singles z23 = __builtin_shufflevector(pair[2], pair[3], 2, 10, 3, 11, 6, 14, 7, 15);
  return {__builtin_shufflevector(xy01, xy23, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(xy01, xy23, 2, 3, 10, 11, 6, 7, 14, 15),
          __builtin_shufflevector(z01, z23, 0, 1, 8, 9, 4, 5, 12, 13)};
}
inline void items(const Vector<Singles>& v, FourSingles (&item)[8]) noexcept {
  const Singles none = v.x - v.x;
  const Singles xy_low = __builtin_shufflevector(v.x, v.y, 0, 8, 1, 9, 4, 12, 5, 13);
  const Singles xy_high = __builtin_shufflevector(v.x, v.y, 2, 10, 3, 11, 6, 14, 7, 15);
  const Singles z_low = __builtin_shufflevector(v.z, none, 0, 8, 1, 9, 4, 12, 5, 13);
  const Singles z_high = __builtin_shufflevector(v.z, none, 2, 10, 3, 11, 6, 14, 7, 15);
  const Singles pair[4] = {__builtin_shufflevector(xy_low, z_low, 0, 1, 8, 9, 4, 5, 12, 13),
                           __builtin_shufflevector(xy_low, z_low, 2, 3, 10, 11, 6, 7, 14, 15),
                           __builtin_shufflevector(xy_high, z_high, 0, 1, 8, 9, 4, 5, 12, 13),
                           __builtin_shufflevector(xy_high, z_high, 2, 3, 10, 11, 6, 7, 14, 15)};
  for (int k = 0; k < 4; ++k) {
    item[k] = __builtin_shufflevector(pair[k], pair[k], 0, 1, 2, 3);
    item[k + 4] = __builtin_shufflevector(pair[k], pair[k], 4, 5, 6, 7);
  }
}
#elif defined(FOLLOWTHROUGH_SHUFFLES)
inline Vector<Doubles> coordinates(const FourDoubles (&item)[8]) noexcept {
  Doubles pair[4];  // items k and k + 4
  for (int k = 0; k < 4; ++k) pair[k] = __builtin_shufflevector(item[k], item[k + 4], 0, 1, 2, 3, 4, 5, 6, 7);
  const Doubles xz01 = __builtin_shufflevector(pair[0], pair[1], 0, 8, 2, 10, 4, 12, 6, 14);
  const Doubles xz23 = __builtin_shufflevector(pair[2], pair[3], 0, 8, 2, 10, 4, 12, 6, 14);
  const Doubles y01 = __builtin_shufflevector(pair[0], pair[1], 1, 9, 3, 11, 5, 13, 7, 15);
  const Doubles y23 = __builtin_shufflevector(pair[2], pair[3], 1, 9, 3, 11, 5, 13, 7, 15);
  return {__builtin_shufflevector(xz01, xz23, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(y01, y23, 0, 1, 8, 9, 4, 5, 12, 13),
          __builtin_shufflevector(xz01, xz23, 2, 3, 10, 11, 6, 7, 14, 15)};
}
inline void items(const Vector<Doubles>& v, FourDoubles (&item)[8]) noexcept {
  const Doubles none = v.x - v.x;
  const Doubles xy_even = __builtin_shufflevector(v.x, v.y, 0, 8, 2, 10, 4, 12, 6, 14);
  const Doubles xy_odd = __builtin_shufflevector(v.x, v.y, 1, 9, 3, 11, 5, 13, 7, 15);
  const Doubles z_even = __builtin_shufflevector(v.z, none, 0, 8, 2, 10, 4, 12, 6, 14);
  const Doubles z_odd = __builtin_shufflevector(v.z, none, 1, 9, 3, 11, 5, 13, 7, 15);
  const Doubles pair[4] = {__builtin_shufflevector(xy_even, z_even, 0, 1, 8, 9, 4, 5, 12, 13),
                           __builtin_shufflevector(xy_odd, z_odd, 0, 1, 8, 9, 4, 5, 12, 13),
                           __builtin_shufflevector(xy_even, z_even, 2, 3, 10, 11, 6, 7, 14, 15),
                           __builtin_shufflevector(xy_odd, z_odd, 2, 3, 10, 11, 6, 7, 14, 15)};
  for (int k = 0; k < 4; ++k) {
    item[k] = __builtin_shufflevector(pair[k], pair[k], 0, 1, 2, 3);
    item[k + 4] = __builtin_shufflevector(pair[k], pair[k], 4, 5, 6, 7);
  }
}
typedef float EightSingles __attribute__((vector_size(8 * sizeof(float))));
inline Vector<Singles> coordinates(const FourSingles (&item)[16]) noexcept {
  Singles quad[4];  // items k, k + 4, k + 8, k + 12
  for (int k = 0; k < 4; ++k) {
    const EightSingles low = __builtin_shufflevector(item[k], item[k + 4], 0, 1, 2, 3, 4, 5, 6, 7);
    const EightSingles high = __builtin_shufflevector(item[k + 8], item[k + 12], 0, 1, 2, 3, 4, 5, 6, 7);
    quad[k] = __builtin_shufflevector(low, high, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
  }
  Singles xy[2], z[2];
  for (int k = 0; k < 2; ++k) {
    xy[k] = __builtin_shufflevector(quad[2 * k], quad[2 * k + 1], 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
    z[k] = __builtin_shufflevector(quad[2 * k], quad[2 * k + 1], 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
  }
  return {__builtin_shufflevector(xy[0], xy[1], 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
          __builtin_shufflevector(xy[0], xy[1], 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31),
          __builtin_shufflevector(z[0], z[1], 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29)};
}
inline void items(const Vector<Singles>& v, FourSingles (&item)[16]) noexcept {
  const Singles none = v.x - v.x;
  const Singles xy_low = __builtin_shufflevector(v.x, v.y, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
  const Singles xy_high = __builtin_shufflevector(v.x, v.y, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
  const Singles z_low = __builtin_shufflevector(v.z, none, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
  const Singles z_high = __builtin_shufflevector(v.z, none, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
  const Singles quad[4] = {__builtin_shufflevector(xy_low, z_low, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
                           __builtin_shufflevector(xy_low, z_low, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31),
                           __builtin_shufflevector(xy_high, z_high, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29),
                           __builtin_shufflevector(xy_high, z_high, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31)};
  for (int k = 0; k < 4; ++k) {
    item[k] = __builtin_shufflevector(quad[k], quad[k], 0, 1, 2, 3);
    item[k + 4] = __builtin_shufflevector(quad[k], quad[k], 4, 5, 6, 7);
    item[k + 8] = __builtin_shufflevector(quad[k], quad[k], 8, 9, 10, 11);
    item[k + 12] = __builtin_shufflevector(quad[k], quad[k], 12, 13, 14, 15);
  }
}
#else
template <typename Number, typename Four, int lanes>
inline Vector<Number> coordinates(const Four (&item)[lanes]) noexcept {
  using Real = decltype(+item[0][0]);
  alignas(64) Real by_axis[3][lanes];
  for (int k = 0; k < lanes; ++k) {
    for (int axis = 0; axis < 3; ++axis) by_axis[axis][k] = item[k][axis];
  }
  return {load(by_axis[0]), load(by_axis[1]), load(by_axis[2])};
}
inline Vector<Doubles> coordinates(const FourDoubles (&item)[lanes_at_once<double>]) noexcept { return coordinates<Doubles>(item); }
inline Vector<Singles> coordinates(const FourSingles (&item)[lanes_at_once<float>]) noexcept { return coordinates<Singles>(item); }
template <typename Number, typename Four, int lanes>
inline void items(const Vector<Number>& v, Four (&item)[lanes]) noexcept {
  using Real = decltype(+item[0][0]);
  Real by_axis[3][lanes];
  std::memcpy(by_axis[0], &v.x, sizeof(v.x));
  std::memcpy(by_axis[1], &v.y, sizeof(v.y));
  std::memcpy(by_axis[2], &v.z, sizeof(v.z));
  for (int k = 0; k < lanes; ++k) {
    const Real four[4] = {by_axis[0][k], by_axis[1][k], by_axis[2][k], 0};
    item[k] = load_four(four);
  }
}
#endif

// The edges of lanes_at_once elements, of which `used` are there: differences in double precision, as exact far away.
template <typename Real>
FOLLOWTHROUGH_INLINE Matrix<NumberOf<Real>> edges_of(const std::int32_t* corners, int used, const double* positions) noexcept {
  using Number = NumberOf<Real>;
  FourOf<Real> edge[3][lanes_at_once<Real>];
  for (int t = 0; t < lanes_at_once<Real>; ++t) {
    const std::int32_t* v = corners + 4 * (t < used ? t : used - 1);
    const FourDoubles origin = load_four(positions + 4 * static_cast<std::int64_t>(v[0]));
    for (int a = 0; a < 3; ++a) convert(minus(load_four(positions + 4 * static_cast<std::int64_t>(v[a + 1])), origin), edge[a][t]);
  }
  const Vector<Number> first = coordinates(edge[0]), second = coordinates(edge[1]), third = coordinates(edge[2]);
  return {{first.x, second.x, third.x}, {first.y, second.y, third.y}, {first.z, second.z, third.z}};
}

// The forces of lanes_at_once elements from `tet` on, of which `used` are in the run.
template <typename Constants, typename Real = typename Constants::Real>
FOLLOWTHROUGH_INLINE std::uint64_t add_forces(const Constants& k, int lane, const std::int32_t* corners, int used,
                                              const double* positions, Real scale, Real smallest_stretch, Real* forces,
                                              Real* energies) noexcept {
  using Number = NumberOf<Real>;
  using Four = FourOf<Real>;
  constexpr int lanes = lanes_at_once<Real>;
  const Matrix<Number> edges = edges_of<Real>(corners, used, positions);
  const Strain<Number> r = strain(k, edges, lane, smallest_stretch, energies != nullptr);
  const Matrix<Number> g = load_matrix(k.gradients, lane);
  const Number volume = load(k.volume + lane) * scale;
  const Vector<Number> x = product(g, times(sum(product(r.f.x, r.s), times(r.cofactors.x, r.pressure)), volume));
  const Vector<Number> y = product(g, times(sum(product(r.f.y, r.s), times(r.cofactors.y, r.pressure)), volume));
  const Vector<Number> z = product(g, times(sum(product(r.f.z, r.s), times(r.cofactors.z, r.pressure)), volume));
  Four force[3][lanes];
  items(Vector<Number>{x.x, y.x, z.x}, force[0]);
  items(Vector<Number>{x.y, y.y, z.y}, force[1]);
  items(Vector<Number>{x.z, y.z, z.z}, force[2]);
  Real inside[lanes], energy[lanes];
  std::memcpy(inside, &r.inside, sizeof(inside));
  if (energies) std::memcpy(energy, &r.energy, sizeof(energy));
  std::uint64_t outside = 0;
  for (int t = 0; t < used; ++t) {
    if (inside[t] == 0) {
      outside |= std::uint64_t(1) << t;
      continue;
    }
    if (energies) energies[lane + t] += energy[t];
    const std::int32_t* v = corners + 4 * t;
    Real* to[4];
    for (int a = 0; a < 4; ++a) to[a] = forces + 4 * static_cast<std::int64_t>(v[a]);
    store_four(load_four(to[0]) - (force[0][t] + force[1][t] + force[2][t]), to[0]);
    for (int a = 0; a < 3; ++a) store_four(load_four(to[a + 1]) + force[a][t], to[a + 1]);
  }
  return outside;
}

template <typename Constants, typename Real = typename Constants::Real>
inline std::uint64_t add_cluster_forces(const Constants* batches, const ElementRun& run, const double* positions, Real scale,
                                        Real smallest_stretch, Real* forces, Real* energies) noexcept {
  constexpr int step = lanes_at_once<Real>;
  std::uint64_t outside = 0;
  for (int tet = 0; tet < run.count; tet += step) {
    const int used = run.count - tet < step ? run.count - tet : step;
    const std::uint64_t bits = add_forces(batches[tet / Constants::lanes], tet % Constants::lanes, run.corners + 4 * tet, used,
                                          positions, scale, smallest_stretch, forces, energies);
    outside |= bits << tet;
  }
  return outside;
}

template <typename Real>
inline void add_cluster_mass(const Real* masses, const ElementRun& run, const Real* values, Real* products) noexcept {
  for (int tet = 0; tet < run.count; ++tet) {
    const std::int32_t* v = run.corners + 4 * tet;
    FourOf<Real> value[4];
    for (int a = 0; a < 4; ++a) value[a] = load_four(values + 4 * static_cast<std::int64_t>(v[a]));
    const FourOf<Real> all = (value[0] + value[1]) + (value[2] + value[3]);
    for (int a = 0; a < 4; ++a) {
      Real* to = products + 4 * static_cast<std::int64_t>(v[a]);
      store_four(load_four(to) + (all + value[a]) * masses[tet], to);
    }
  }
}

// 1 where a symmetric matrix is positive definite, 0 elsewhere.
template <typename Real>
inline NumberOf<Real> share_of_stress(const Matrix<NumberOf<Real>>& s) noexcept {
  using Number = NumberOf<Real>;
  const Number minor = s.x.x * s.y.y - s.x.y * s.x.y;
  const Number none = minor - minor;
  return (s.x.x > Real(0)) & (minor > Real(0)) & (dot(s.x, cross(s.y, s.z)) > Real(0)) ? none + Real(1) : none;
}

// A row of a stiffness block: rows of the terms named at the top.
template <typename Number>
inline Vector<Number> block_row(const Number& near, const Vector<Number>& left, const Number& by_a, const Vector<Number>& moved_a,
                                const Number& by_c, const Vector<Number>& moved_c, const Number& by_normal,
                                const Vector<Number>& normal_c) noexcept {
  return sum(sum(times(left, near), times(moved_a, by_c)), sum(times(moved_c, by_a), times(normal_c, by_normal)));
}

// scale times the blocks of the corner pairs 11, 12, 13, 22, 23, 33.
template <typename Constants, typename Real = typename Constants::Real>
FOLLOWTHROUGH_INLINE void store_blocks(const Constants& k, const Matrix<NumberOf<Real>>& edges, int lane, Real scale,
                                       Real smallest_stretch, bool convex, Real (*blocks)[9][Constants::lanes],
                                       Real* inside) noexcept {
  using Number = NumberOf<Real>;
  using Vec = Vector<Number>;
  const Strain<Number> r = strain(k, edges, lane, smallest_stretch, false);
  store(r.inside, inside + lane);
  const Number v = load(k.volume + lane) * scale, mu = v * load(k.mu + lane), lambda = v * load(k.lambda + lane);
  const Number bulk = v * r.bulk, pressure = convex ? v - v : v * r.pressure;
  const Number keep = convex ? share_of_stress<Real>(r.s) : v - v + Real(1);
  const Matrix<Number> left = {product(r.f, r.f.x), product(r.f, r.f.y), product(r.f, r.f.z)};  // F F^T
  Vec g[3], moved[3], normal[3], pulled[3];                                                     // a corner each: g, F g, A g, S g
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
      const Vec axis = times(product(r.f, cross(g[a], g[c])), pressure);
      const Vec by_a = times(moved[a], lambda), by_c = times(moved[c], mu), by_normal = times(normal[a], bulk);
      Vec x = block_row(near, left.x, by_a.x, moved[a], by_c.x, moved[c], by_normal.x, normal[c]);
      Vec y = block_row(near, left.y, by_a.y, moved[a], by_c.y, moved[c], by_normal.y, normal[c]);
      Vec z = block_row(near, left.z, by_a.z, moved[a], by_c.z, moved[c], by_normal.z, normal[c]);
      x = {x.x + pull, x.y + axis.z, x.z - axis.y};
      y = {y.x - axis.z, y.y + pull, y.z + axis.x};
      z = {z.x + axis.y, z.y - axis.x, z.z + pull};
      store(x, blocks[pair], lane);
      store(y, blocks[pair] + 3, lane);
      store(z, blocks[pair] + 6, lane);
      ++pair;
    }
  }
}

// Corner 0 has minus the sum of the others, as row and as column: the blocks 01, 02, 03, 00 from the six before them.
inline void store_first_corner(float (*blocks)[9][single_lanes], int lane) noexcept {
  constexpr int turned[9] = {0, 3, 6, 1, 4, 7, 2, 5, 8};
  for (int k = 0; k < 9; ++k) {
    const auto at = [&](int block) { return load(blocks[block][k] + lane); };
    const auto other_way = [&](int block) { return load(blocks[block][turned[k]] + lane); };
    const Singles first = at(0) + other_way(1) + other_way(2), second = at(1) + at(3) + other_way(4), third = at(2) + at(4) + at(5);
    const Singles none = first - first;
    store(none - first, blocks[6][k] + lane);
    store(none - second, blocks[7][k] + lane);
    store(none - third, blocks[8][k] + lane);
    store(first + second + third, blocks[9][k] + lane);
  }
}

}  // namespace

std::uint64_t cluster_forces(const BatchConstants* batches, const ElementRun& run, const double* positions, double scale,
                             double smallest_stretch, double* forces, double* energy) noexcept {
  double energies[batch_lanes] = {};
  const std::uint64_t outside =
      add_cluster_forces(batches, run, positions, scale, smallest_stretch, forces, energy ? energies : nullptr);
  if (energy) {
    *energy = 0;
    for (const double lane : energies) *energy += lane;
  }
  return outside;
}

std::uint64_t cluster_forces(const SingleBatchConstants* batches, const ElementRun& run, const double* positions, float scale,
                             float smallest_stretch, float* forces) noexcept {
  return add_cluster_forces(batches, run, positions, scale, smallest_stretch, forces, static_cast<float*>(nullptr));
}

void cluster_mass(const double* masses, const ElementRun& run, const double* values, double* products) noexcept {
  add_cluster_mass(masses, run, values, products);
}

void cluster_mass(const float* masses, const ElementRun& run, const float* values, float* products) noexcept {
  add_cluster_mass(masses, run, values, products);
}

void batch_stiffness(const BatchConstants& k, ElementBatch& b, double smallest_stretch, bool convex) noexcept {
  for (int lane = 0; lane < batch_lanes; lane += lanes_at_once<double>) {
    store_blocks(k, load_matrix(b.edges, lane), lane, 1.0, smallest_stretch, convex, b.blocks, b.inside);
  }
}

void run_stiffness(const SingleBatchConstants& k, const ElementRun& run, const double* positions, float scale,
                   float smallest_stretch, bool convex, SingleStiffness& out) noexcept {
  for (int lane = 0; lane < single_lanes; lane += lanes_at_once<float>) {
    const int first = lane < run.count ? lane : run.count - 1;  // lanes to spare repeat the last element
    const Matrix<Singles> edges = edges_of<float>(run.corners + 4 * first, run.count - first, positions);
    store_blocks(k, edges, lane, scale, smallest_stretch, convex, out.blocks, out.inside);
    store_first_corner(out.blocks, lane);
  }
}

}  // namespace followthrough::FOLLOWTHROUGH_ISA
