// Rod: the energy of bending and twist, at the vertex between two edges.
//
// Each edge has a frame (x along it, y and z across) that is glued to the hair. From the frame F before a vertex to the
// frame G after it leads a turn by some angle phi about some axis a; its Darboux vector, in the axes of either,
//
//   kappa = 2 tan(phi / 2) a = 2 (z.y' - y.z', x.z' - z.x', y.x' - x.y') / (1 + x.x' + y.y' + z.z')
//
// has the twist in x and both bends in y and z; kappa0 is that of the rest pose, so curls hold. With l the mean of the
// lengths of the two edges, the energy over the mass of a metre of hair is
//
//   E = ((kappa - kappa0)^T K (kappa - kappa0)) / (2 l),   K = diag(C, B, B)                            [m^3/s^2]
//   B = E I / (rho A),   C = G J / (rho A)                                                            [m^4/s^2]
//
// When the two frames turn by small angles w and w' [rad, in the world], d = F^T (w' - w) and
//
//   T d = d - kappa x d / 2 + kappa (kappa . d) / 4        changes kappa by so much,
//   m = F T^T K (kappa - kappa0) / l                        is the gradient by w', and less the gradient by w: the
//   couple S = F T^T K T F^T / l                                    is the matrix that is used.
//
// For the circular section, with q = |kappa|^2 / 4 and the first column c = T^T (1, 0, 0) = (1, k_z / 2, -k_y / 2) +
// k_x kappa / 4,
//
//   T^T K T = B (1 + q) (1 + kappa kappa^T / 4) + (C - B) c c^T
//
// It is Gauss's and Newton's, positive definite: what is left out, the second derivative of kappa times the couple,
// vanishes at rest, and can be negative where hair is bent far beyond it. An equilibrium does not depend on the matrix,
// only how fast it is found. Near a half turn, where the vector has no bound, |kappa| ends at 40, and
// at a half turn itself, where no axis is one, it is 0.
// Source: energies of Bergou, Wardetzky, Robinson, Audoly, Grinspun, "Discrete Elastic Rods", SIGGRAPH 2008; frames
// that are carried along in time as in Bergou, Audoly, Vouga, Wardetzky, Grinspun, "Discrete Viscous Threads", SIGGRAPH
// 2010; one vector for bends and twist, without an angle, so that it needs no more than + - * /: ours. Checks:
// tests/sim/rod_test.cpp (against finite differences), tests/validation/rod_test.cpp.
#pragma once

#include "sim/passes/local_shape.h"
#include "sim/passes/rod_math.h"

#ifdef __OPENCL_C_VERSION__
typedef struct {
  Real3 couple;
  Symmetric matrix;
} Joint;
#define JOINT Joint
#else
#define JOINT Joint<Real>
namespace strandbake {
template <class Real>
struct Joint {
  VEC3 couple;       // m
  SYMMETRIC matrix;  // S
};
}  // namespace strandbake
#endif

STRAND_MATH_BEGIN

STRAND_FN VEC3 rod_curvature(FRAME f, FRAME g) {
  VEC3 fz = outer(f.x, f.y);
  VEC3 gz = outer(g.x, g.y);
  Real k = (Real)1.0f + ((inner(f.x, g.x) + inner(f.y, g.y)) + inner(fz, gz));
  VEC3 v =
      make_vec3(inner(fz, g.y) - inner(f.y, gz), inner(f.x, gz) - inner(fz, g.x), inner(f.y, g.x) - inner(f.x, g.y));
  Real least = SQRT(inner(v, v)) * (Real)0.05f;
  k = SELECT(k > least, k, least);
  return v * ((Real)2.0f / SELECT(k > (Real)1e-9f, k, (Real)1e-9f));
}

// 1 / l, from both lengths; 0 for a point.
STRAND_FN Real inverse_joint_length(Real before, Real after) {
  Real sum = before + after;
  return SELECT(sum > (Real)1e-15f, (Real)2.0f, (Real)0.0f) / SELECT(sum > (Real)1e-15f, sum, (Real)1.0f);
}

// `bend`, `twist`: B / l and C / l, times h^2.
STRAND_FN JOINT rod_joint(FRAME f, FRAME g, VEC3 rest_curvature, Real bend, Real twist) {
  VEC3 k = rod_curvature(f, g);
  VEC3 off = k - rest_curvature;
  VEC3 b = make_vec3(off.x * twist, off.y * bend, off.z * bend);
  VEC3 column = make_vec3((Real)1.0f, (Real)0.5f * k.z, (Real)-0.5f * k.y) + k * ((Real)0.25f * k.x);
  VEC3 world_k = from_frame(f, k);
  VEC3 world_column = from_frame(f, column);
  Real q = (Real)0.25f * inner(k, k);
  Real scale = bend * ((Real)1.0f + q);
  JOINT joint;
  joint.couple = from_frame(f, b + outer(k, b) * (Real)0.5f + k * ((Real)0.25f * inner(k, b)));
  SYMMETRIC s;
  s.xx = s.yy = s.zz = scale;
  s.xy = s.xz = s.yz = (Real)0.0f;
  s = plus_square(s, world_k, (Real)0.25f * scale);
  joint.matrix = plus_square(s, world_column, twist - bend);
  return joint;
}

// The rest curvature with which a rod whose curvature is k bears the couple (in the frame's axes) as it is. `bend` and
// `twist` as above, not 0.
STRAND_FN VEC3 curvature_that_bears(VEC3 k, VEC3 couple, Real bend, Real twist) {
  VEC3 b = (couple - outer(k, couple) * (Real)0.5f) * ((Real)1.0f / ((Real)1.0f + (Real)0.25f * inner(k, k)));
  return k - make_vec3(b.x / twist, b.y / bend, b.z / bend);
}

// f turned by the small angle w as Cayley's map has it, exactly a turn: by less than a half one, however large w is.
STRAND_FN VEC3 turned(VEC3 v, VEC3 w, Real share) {
  VEC3 across = outer(w, v);
  return v + (across + outer(w, across) * (Real)0.5f) * share;
}
STRAND_FN FRAME turned_frame(FRAME f, VEC3 w) {
  Real share = (Real)1.0f / ((Real)1.0f + (Real)0.25f * inner(w, w));
  FRAME to;
  to.x = turned(f.x, w, share);
  to.y = turned(f.y, w, share);
  // Less what rounding adds, so that it does not add up: lengths to first order, y across x.
  Real error = (Real)0.5f * (inner(to.x, to.x) - (Real)1.0f);
  to.x = to.x - to.x * error;
  Real lean = inner(to.x, to.y);
  to.y = to.y - to.x * lean;
  Real error_y = (Real)0.5f * (inner(to.y, to.y) - (Real)1.0f);
  to.y = to.y - to.y * error_y;
  // What does not turn keeps its bits.
  Real turns = inner(w, w);
  to.x = make_vec3(SELECT(turns > (Real)0.0f, to.x.x, f.x.x), SELECT(turns > (Real)0.0f, to.x.y, f.x.y),
                   SELECT(turns > (Real)0.0f, to.x.z, f.x.z));
  to.y = make_vec3(SELECT(turns > (Real)0.0f, to.y.x, f.y.x), SELECT(turns > (Real)0.0f, to.y.y, f.y.y),
                   SELECT(turns > (Real)0.0f, to.y.z, f.y.z));
  return to;
}

// f, as glued to the frame `before` that has become `now`. To the bit f where that has not turned.
STRAND_FN FRAME carried_along(FRAME before, FRAME now, FRAME f) {
  VEC3 dx = now.x - before.x;
  VEC3 dy = now.y - before.y;
  Real turns = inner(dx, dx) + inner(dy, dy);
  VEC3 x = from_frame(now, into_frame(before, f.x));
  VEC3 y = from_frame(now, into_frame(before, f.y));
  FRAME to;
  to.x = make_vec3(SELECT(turns > (Real)0.0f, x.x, f.x.x), SELECT(turns > (Real)0.0f, x.y, f.x.y),
                   SELECT(turns > (Real)0.0f, x.z, f.x.z));
  to.y = make_vec3(SELECT(turns > (Real)0.0f, y.x, f.y.x), SELECT(turns > (Real)0.0f, y.y, f.y.y),
                   SELECT(turns > (Real)0.0f, y.z, f.y.z));
  return to;
}

STRAND_MATH_END
