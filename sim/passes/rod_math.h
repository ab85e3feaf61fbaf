// Three by three matrices for the rod, in the dialect of strand_math.h.
//
//   SYMMETRIC       a symmetric matrix
//   MATRIX          any, by its rows
//   FACTORED        a symmetric, positive definite one as L D L^T: what is below the diagonal of L, and 1 / D
#pragma once

#include "sim/passes/strand_math.h"

#ifdef __OPENCL_C_VERSION__
typedef struct {
  Real xx, yy, zz, xy, xz, yz;
} Symmetric;
#define SYMMETRIC Symmetric
typedef struct {
  Real3 x, y, z;
} Matrix;
#define MATRIX Matrix
typedef struct {
  Real yx, zx, zy;
  Real3 inverse;
} Factored;
#define FACTORED Factored
#else
#define SYMMETRIC Symmetric<Real>
#define MATRIX Matrix<Real>
#define FACTORED Factored<Real>

namespace strandbake {

template <class Real>
struct Symmetric {
  Real xx, yy, zz, xy, xz, yz;
};
template <class Real>
struct Matrix {
  VEC3 x, y, z;
};
template <class Real>
struct Factored {
  Real yx, zx, zy;
  VEC3 inverse;
};

}  // namespace strandbake
#endif

STRAND_MATH_BEGIN

// a + k 1
STRAND_FN SYMMETRIC plus_diagonal(SYMMETRIC a, Real k) {
  a.xx = a.xx + k;
  a.yy = a.yy + k;
  a.zz = a.zz + k;
  return a;
}

// a + k v v^T
STRAND_FN SYMMETRIC plus_square(SYMMETRIC a, VEC3 v, Real k) {
  VEC3 kv = v * k;
  a.xx = a.xx + kv.x * v.x;
  a.yy = a.yy + kv.y * v.y;
  a.zz = a.zz + kv.z * v.z;
  a.xy = a.xy + kv.x * v.y;
  a.xz = a.xz + kv.x * v.z;
  a.yz = a.yz + kv.y * v.z;
  return a;
}

STRAND_FN SYMMETRIC symmetric_sum(SYMMETRIC a, SYMMETRIC b) {
  a.xx = a.xx + b.xx;
  a.yy = a.yy + b.yy;
  a.zz = a.zz + b.zz;
  a.xy = a.xy + b.xy;
  a.xz = a.xz + b.xz;
  a.yz = a.yz + b.yz;
  return a;
}

STRAND_FN VEC3 symmetric_times(SYMMETRIC a, VEC3 v) {
  return make_vec3(a.xx * v.x + a.xy * v.y + a.xz * v.z, a.xy * v.x + a.yy * v.y + a.yz * v.z,
                   a.xz * v.x + a.yz * v.y + a.zz * v.z);
}

// a - b^T c, where that is symmetric: upper half of it.
STRAND_FN SYMMETRIC minus_product(SYMMETRIC a, MATRIX b, MATRIX c) {
  a.xx = a.xx - (b.x.x * c.x.x + b.y.x * c.y.x + b.z.x * c.z.x);
  a.yy = a.yy - (b.x.y * c.x.y + b.y.y * c.y.y + b.z.y * c.z.y);
  a.zz = a.zz - (b.x.z * c.x.z + b.y.z * c.y.z + b.z.z * c.z.z);
  a.xy = a.xy - (b.x.x * c.x.y + b.y.x * c.y.y + b.z.x * c.z.y);
  a.xz = a.xz - (b.x.x * c.x.z + b.y.x * c.y.z + b.z.x * c.z.z);
  a.yz = a.yz - (b.x.y * c.x.z + b.y.y * c.y.z + b.z.y * c.z.z);
  return a;
}

// b v
STRAND_FN VEC3 matrix_times(MATRIX b, VEC3 v) {
  return make_vec3(inner(b.x, v), inner(b.y, v), inner(b.z, v));
}

// b^T v
STRAND_FN VEC3 transposed_times(MATRIX b, VEC3 v) {
  return b.x * v.x + b.y * v.y + b.z * v.z;
}

// A pivot that rounding has eaten up counts as a millionth of what it was; 0, which only padding has, as 1.
STRAND_FN Real safe_inverse(Real pivot, Real diagonal) {
  Real least = (Real)1e-6f * diagonal;
  Real safe = SELECT(pivot > least, pivot, least);
  return (Real)1.0f / SELECT(safe > (Real)0.0f, safe, (Real)1.0f);
}

STRAND_FN FACTORED factored(SYMMETRIC a) {
  FACTORED f;
  f.inverse.x = safe_inverse(a.xx, a.xx);
  f.yx = a.xy * f.inverse.x;
  f.zx = a.xz * f.inverse.x;
  f.inverse.y = safe_inverse(a.yy - f.yx * a.xy, a.yy);
  Real zy = a.yz - f.zx * a.xy;
  f.zy = zy * f.inverse.y;
  f.inverse.z = safe_inverse((a.zz - f.zx * a.xz) - f.zy * zy, a.zz);
  return f;
}

// L^-1 v
STRAND_FN VEC3 half_solved(FACTORED f, VEC3 v) {
  Real y = v.y - f.yx * v.x;
  return make_vec3(v.x, y, (v.z - f.zx * v.x) - f.zy * y);
}

// L^-T v
STRAND_FN VEC3 back_solved(FACTORED f, VEC3 v) {
  Real y = v.y - f.zy * v.z;
  return make_vec3((v.x - f.yx * y) - f.zx * v.z, y, v.z);
}

STRAND_FN MATRIX half_solved_rows(FACTORED f, MATRIX b) {
  b.y = b.y - b.x * f.yx;
  b.z = (b.z - b.x * f.zx) - b.y * f.zy;
  return b;
}

STRAND_FN MATRIX scaled_rows(MATRIX b, VEC3 k) {
  b.x = b.x * k.x;
  b.y = b.y * k.y;
  b.z = b.z * k.z;
  return b;
}

STRAND_MATH_END
