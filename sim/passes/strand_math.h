// The dialect in which the passes are written: the part that C++ templates and OpenCL C have in common, so that the
// mathematics is written once and runs in float, in double, in lanes, and on a device.
//
//   Real            a number: float, double, or W of either (Lanes)
//   VEC3            three of them, with + and - and * by a Real
//   FRAME           the orthonormal frame of a vertex: x and y; z = x × y
//   TWIST           a turn in the plane: cosine and sine of its angle, as a complex number
//   STRAND_FN       a pure function on values; no overloads, no pointers, no references, no name of an OpenCL function
//   SELECT(m, a, b) a where the comparison m holds, else b; a and b are both computed
//   SQRT(a)         exactly rounded
//   OF_PRECISION(f, d)  f where Real is of floats, d where it is of doubles; both are written as floats
//
// Only + - * / sqrt and comparisons, each rounded once, in the order written: that is what makes results equal
// everywhere.
#pragma once

#ifdef __OPENCL_C_VERSION__

// The program is built with REAL and REAL3: float and float3, or double and double3.
typedef REAL Real;
typedef REAL3 Real3;
#define STRAND_FN static
#define VEC3 Real3
typedef struct {
  Real3 x, y;
} Frame;
#define FRAME Frame
typedef struct {
  Real re, im;
} Twist;
#define TWIST Twist
#define SELECT(m, a, b) ((m) ? (a) : (b))
#define SQRT(a) sqrt(a)
#define OF_PRECISION(f, d) ((Real)(sizeof(Real) == 8 ? (d) : (f)))
#define STRAND_MATH_BEGIN
#define STRAND_MATH_END

#else

#define STRAND_FN       \
  template <class Real> \
  inline __attribute__((always_inline))
#define VEC3 Vec3<Real>
#define FRAME Frame<Real>
#define TWIST Twist<Real>
#define SELECT(m, a, b) select(m, a, b)
#define SQRT(a) square_root(a)
#define OF_PRECISION(f, d) ((Real)(sizeof(ScalarOf<Real>) == 8 ? (d) : (f)))
#define STRAND_MATH_BEGIN namespace strandbake {
#define STRAND_MATH_END }

namespace strandbake {

template <class Real>
struct Vec3 {
  Real x, y, z;
};

template <class Real>
struct ScalarOfLanes {
  using Type = typename Real::Scalar;
};
template <>
struct ScalarOfLanes<float> {
  using Type = float;
};
template <>
struct ScalarOfLanes<double> {
  using Type = double;
};
template <class Real>
using ScalarOf = typename ScalarOfLanes<Real>::Type;

// Scalars take part in the same text as lanes.
inline __attribute__((always_inline)) float select(bool m, float a, float b) {
  return m ? a : b;
}
inline __attribute__((always_inline)) double select(bool m, double a, double b) {
  return m ? a : b;
}
inline __attribute__((always_inline)) float square_root(float a) {
  return __builtin_sqrtf(a);
}
inline __attribute__((always_inline)) double square_root(double a) {
  return __builtin_sqrt(a);
}

STRAND_FN VEC3 operator+(VEC3 a, VEC3 b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
STRAND_FN VEC3 operator-(VEC3 a, VEC3 b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
STRAND_FN VEC3 operator*(VEC3 a, Real s) {
  return {a.x * s, a.y * s, a.z * s};
}

template <class Real>
struct Frame {
  VEC3 x, y;
};

template <class Real>
struct Twist {
  Real re, im;
};

}  // namespace strandbake

#endif

STRAND_MATH_BEGIN

STRAND_FN VEC3 make_vec3(Real x, Real y, Real z) {
  VEC3 v;
  v.x = x;
  v.y = y;
  v.z = z;
  return v;
}

STRAND_FN Real inner(VEC3 a, VEC3 b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}

STRAND_FN VEC3 outer(VEC3 a, VEC3 b) {
  return make_vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
}

// A rotation given by the rows of its matrix.
STRAND_FN VEC3 rotate_by_rows(VEC3 row_x, VEC3 row_y, VEC3 row_z, VEC3 v) {
  return make_vec3(inner(row_x, v), inner(row_y, v), inner(row_z, v));
}

// Squared length [m^2] below which a segment counts as a point without direction: 1e-15 m, far below any hair, and its
// products stay normal numbers in float.
#define POINT_LENGTH_SQUARED ((Real)1e-30f)

STRAND_MATH_END
