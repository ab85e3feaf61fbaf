// Rod: all equations of a strand at once, from the tip to the root and back.
//
// A step of implicit Euler finds the least of
//
//   sum of m_i |P_i - P*_i|^2 / 2  +  h^2 (the energies of rod_bend.h and rod_stretch.h)                  [m^3]
//
// with P* where vertices would go on their own and m_i the length of hair that moves with a vertex. Unknown are the
// small angle w_j by which edge j turns (and its twist with it) and the change s_j of its length; a vertex then moves
// by x_j = x_{j-1} + w_j x e_j + s_j t_j. Strands are chains, so all that hangs on vertex j can be summed up in what it
// costs to move that vertex by x and to turn the edge before it by w:
//
//   V(x, w) = x^T A x / 2 + w^T C x + w^T D w / 2 + a.x + d.w + const
//
// From vertex j to vertex j - 1:
//   1. the vertex itself:       A += m,  a += m (P - P*)
//   2. the load of the edge:    D += plus_load(-a)
//   3. its stretch, if any:     the least over s
//   4. to its near end:         x -> x + w x e:  D += C [e]^T + [e] C'^T,  C' = C + [e] A,  d += e x a
//   5. the joint there:         w -> w + u, the least over u with u^T S u / 2 + m.u:  with D + S = L G L^T,
//      Y = L^-1 (C | D), y = L^-1 (d + m):   A, C, D, a, d  less  Y^T G^-1 Y and Y^T G^-1 y
// Then from the root, which does not move, u = -L^-T G^-1 (Y (x, w) + y). All that is taken away in 5. is what hangs on
// vertex j less what its joint holds, so a joint may be as stiff or soft as it likes, and lengths may be rigid (no
// stretch) without a large number anywhere. Twist has next to no inertia; a ten-thousandth of that of the edge keeps
// D + S regular in floats, a hundred-millionth in doubles. It rubs, as twist goes on from no turn in each step, and the
// more so the shorter that is: a ten-thousandth would keep doubles from converging.
// What is taken away in 5. may be all but a float's last digits: some more of A and D than these are worth stays, or
// soft joints beyond pinned vertices had what is less than nothing. As all of the matrix, it has no part in what an
// iteration ends at.
// Each edge begins turned on, as it turned in the substep before. Else x were wrong by |w|^2 |e| / 2 in the first
// iteration, as much as an acceleration makes in a step however short, and hair that swings felt but half of its
// centrifugal force.
// A Newton iteration is exact where the energy is quadratic. As large turns go by Cayley's map, no step is more than
// half a turn, and lengths hold however long it is; there is no search along a line.
// Source: the order of elimination of Featherstone, "The Calculation of Robot Dynamics Using Articulated-Body
// Inertias", 1983; for implicit rods: ours. Checks: tests/sim/rod_test.cpp (against a dense solve).
#pragma once

#include "sim/passes/rod_bend.h"
#include "sim/passes/rod_math.h"
#include "sim/passes/rod_stretch.h"

#ifdef __OPENCL_C_VERSION__
typedef struct {
  Symmetric A, D;
  Matrix C;
  Real3 a, d;
} Link;
#define LINK Link
typedef struct {
  Factored factors;
  Matrix by_x, by_w;
  Real3 offset;
} JointGain;
#define JOINT_GAIN JointGain
typedef struct {
  Real3 by_x, by_w;
  Real offset;
} StretchGain;
#define STRETCH_GAIN StretchGain
typedef struct {
  Link link;
  JointGain gain;
} Joined;
#define JOINED Joined
#else
#define LINK Link<Real>
#define JOINT_GAIN JointGain<Real>
#define STRETCH_GAIN StretchGain<Real>
#define JOINED Joined<Real>
namespace strandbake {
template <class Real>
struct Link {  // V
  SYMMETRIC A, D;
  MATRIX C;
  VEC3 a, d;
};
template <class Real>
struct JointGain {  // u = -L^-T (by_x x + by_w w + offset)
  FACTORED factors;
  MATRIX by_x, by_w;
  VEC3 offset;
};
template <class Real>
struct StretchGain {  // s = -(by_x.x + by_w.w + offset), x of the far end without it
  VEC3 by_x, by_w;
  Real offset;
};
template <class Real>
struct Joined {
  LINK link;
  JOINT_GAIN gain;
};
}  // namespace strandbake
#endif

STRAND_MATH_BEGIN

// What a pinned vertex counts for in place of 1: enough to hold whatever hangs on it.
#define PINNED_SHARE ((Real)1e5f)

// And one that is drawn to a goal by the share `stiffness` of the way, as P* has it: it stays there when others pull.
STRAND_FN Real held_share(Real stiffness) {
  Real rest = (Real)1.0f - stiffness;
  return (Real)1.0f / SELECT(rest > (Real)1e-5f, rest, (Real)1e-5f);
}

// Beyond it a substep is too long for an edge to go on as it went.
#define MOST_TURN ((Real)0.25f)

// Sine and axis of the angle by which an edge has turned, at most that; less where its length has changed.
STRAND_FN VEC3 edge_turn(VEC3 before, VEC3 now) {
  Real before2 = inner(before, before);
  Real now2 = inner(now, now);
  Real longer2 = SELECT(before2 > now2, before2, now2);
  VEC3 turn = outer(before, now) * ((Real)1.0f / SELECT(longer2 > POINT_LENGTH_SQUARED, longer2, (Real)1.0f));
  Real turn2 = inner(turn, turn);
  Real most2 = MOST_TURN * MOST_TURN;
  return turn * SELECT(turn2 > most2, MOST_TURN / SQRT(SELECT(turn2 > most2, turn2, (Real)1.0f)), (Real)1.0f);
}

// a with the share k more on its diagonal.
STRAND_FN SYMMETRIC plus_share(SYMMETRIC a, Real k) {
  a.xx = a.xx + a.xx * k;
  a.yy = a.yy + a.yy * k;
  a.zz = a.zz + a.zz * k;
  return a;
}

STRAND_FN LINK no_link(Real zero) {
  LINK v;
  v.A.xx = v.A.yy = v.A.zz = v.A.xy = v.A.xz = v.A.yz = zero;
  v.D = v.A;
  v.a = v.d = make_vec3(zero, zero, zero);
  v.C.x = v.C.y = v.C.z = v.a;
  return v;
}

// 1 and 2. `off`: P - P*.
STRAND_FN LINK with_vertex(LINK v, Real mass, VEC3 off, VEC3 along, VEC3 edge) {
  v.A = plus_diagonal(v.A, mass);
  v.a = v.a + off * mass;
  v.D = plus_square(v.D, edge, OF_PRECISION(1e-4f, 1e-8f) * mass);
  v.D = plus_load(v.D, along, edge, make_vec3((Real)0.0f, (Real)0.0f, (Real)0.0f) - v.a);
  return v;
}

// 3. `stiffness`: h^2 Y / L, `off`: |e| - L.
STRAND_FN STRETCH_GAIN stretch_gain(LINK v, VEC3 along, Real stiffness, Real off) {
  VEC3 by_x = symmetric_times(v.A, along);
  Real inverse = (Real)1.0f / (stiffness + inner(along, by_x));
  STRETCH_GAIN g;
  g.by_x = by_x * inverse;
  g.by_w = matrix_times(v.C, along) * inverse;
  g.offset = (inner(v.a, along) + stiffness * off) * inverse;
  return g;
}
STRAND_FN LINK with_stretch(LINK v, VEC3 along, Real stiffness, STRETCH_GAIN g) {
  Real pivot = stiffness + inner(along, symmetric_times(v.A, along));
  VEC3 x = g.by_x * pivot;
  VEC3 w = g.by_w * pivot;
  v.A = plus_square(v.A, g.by_x, (Real)0.0f - pivot);
  v.D = plus_square(v.D, g.by_w, (Real)0.0f - pivot);
  v.C.x = v.C.x - g.by_x * w.x;
  v.C.y = v.C.y - g.by_x * w.y;
  v.C.z = v.C.z - g.by_x * w.z;
  v.a = v.a - x * g.offset;
  v.d = v.d - w * g.offset;
  return v;
}

// 4
STRAND_FN LINK at_near_end(LINK v, VEC3 e) {
  MATRIX to;
  to.x = v.C.x + make_vec3(e.y * v.A.xz - e.z * v.A.xy, e.y * v.A.yz - e.z * v.A.yy, e.y * v.A.zz - e.z * v.A.yz);
  to.y = v.C.y + make_vec3(e.z * v.A.xx - e.x * v.A.xz, e.z * v.A.xy - e.x * v.A.yz, e.z * v.A.xz - e.x * v.A.zz);
  to.z = v.C.z + make_vec3(e.x * v.A.xy - e.y * v.A.xx, e.x * v.A.yy - e.y * v.A.xy, e.x * v.A.yz - e.y * v.A.xz);
  VEC3 x = outer(e, v.C.x), y = outer(e, v.C.y), z = outer(e, v.C.z);
  VEC3 to_x = outer(e, to.x), to_y = outer(e, to.y), to_z = outer(e, to.z);
  v.D.xx = v.D.xx + (x.x + to_x.x);
  v.D.yy = v.D.yy + (y.y + to_y.y);
  v.D.zz = v.D.zz + (z.z + to_z.z);
  v.D.xy = v.D.xy + (x.y + to_y.x);
  v.D.xz = v.D.xz + (x.z + to_z.x);
  v.D.yz = v.D.yz + (y.z + to_z.y);
  v.C = to;
  v.d = v.d + outer(e, v.a);
  return v;
}

// 5
STRAND_FN JOINED with_joint(LINK v, JOINT joint) {
  JOINT_GAIN g;
  g.factors = factored(symmetric_sum(v.D, joint.matrix));
  VEC3 inverse = g.factors.inverse;
  MATRIX d;
  d.x = make_vec3(v.D.xx, v.D.xy, v.D.xz);
  d.y = make_vec3(v.D.xy, v.D.yy, v.D.yz);
  d.z = make_vec3(v.D.xz, v.D.yz, v.D.zz);
  VEC3 y = half_solved(g.factors, v.d + joint.couple);
  MATRIX by_x = half_solved_rows(g.factors, v.C);
  MATRIX by_w = half_solved_rows(g.factors, d);
  g.by_x = scaled_rows(by_x, inverse);
  g.by_w = scaled_rows(by_w, inverse);
  g.offset = make_vec3(y.x * inverse.x, y.y * inverse.y, y.z * inverse.z);
  v.A = minus_product(plus_share(v.A, (Real)3e-7f), by_x, g.by_x);
  v.D = minus_product(plus_share(v.D, (Real)1e-6f), by_w, g.by_w);
  v.C.x = v.C.x - transposed_times(by_x, make_vec3(g.by_w.x.x, g.by_w.y.x, g.by_w.z.x));
  v.C.y = v.C.y - transposed_times(by_x, make_vec3(g.by_w.x.y, g.by_w.y.y, g.by_w.z.y));
  v.C.z = v.C.z - transposed_times(by_x, make_vec3(g.by_w.x.z, g.by_w.y.z, g.by_w.z.z));
  v.a = v.a - transposed_times(g.by_x, y);
  v.d = v.d - transposed_times(g.by_w, y);
  JOINED joined;
  joined.link = v;
  joined.gain = g;
  return joined;
}

STRAND_FN VEC3 joint_turn(JOINT_GAIN g, VEC3 x, VEC3 w) {
  return back_solved(g.factors, make_vec3((Real)0.0f, (Real)0.0f, (Real)0.0f) -
                                    ((matrix_times(g.by_x, x) + matrix_times(g.by_w, w)) + g.offset));
}

STRAND_FN Real stretch_by(STRETCH_GAIN g, VEC3 x, VEC3 w) {
  return (Real)0.0f - ((inner(g.by_x, x) + inner(g.by_w, w)) + g.offset);
}

STRAND_MATH_END
