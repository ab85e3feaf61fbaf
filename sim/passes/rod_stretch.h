// Rod: stretch, and what a load does to an edge that turns.
//
// Stretch. An edge of the length L at rest and |e| now has the energy over the mass of a metre of hair
//
//   E = Y (|e| - L)^2 / (2 L),   Y = E / rho                                                       [m^3/s^2]
//
// with the gradient Y (|e| - L) / L and the matrix Y / L by s, the change of |e|: exact. Hair hardly stretches (Y is
// 3e6 m^2/s^2), so lengths are exact where nothing else is asked for: s = 0.
//
// Load. Of what pulls at the far end, r, an edge e that turns by the small angle w feels, to second order,
//
//   -r . (w x e + w x (w x e) / 2)
//
// The first term is the couple. The matrix of the second is (r.e) 1 - (r e^T + e r^T) / 2. With c = e x r it is, but
// for what follows, left as it is where r.e, the pull along the edge, is positive, and left out where it is negative:
//
//   (r.e) (1 - x x^T)                                   [x: along the edge]
//
// Of what pulls across the edge remains -(n x^T + x n^T) |e| / 2, n = r - x (x.r): it has eigenvalues of both signs, +-
// |c| / 2. It is replaced by the least upper bound that does not mix them,
//
//   |c| (1 - c c^T / |c|^2) / 2
//
// Left out, hair that a load bends far trembles for ever. As the matrix has no part in what is at rest, the bound
// costs no accuracy there. Source: ours.
// Checks: tests/sim/rod_test.cpp (against finite differences).
#pragma once

#include "sim/passes/rod_math.h"

STRAND_MATH_BEGIN

// h^2 Y / L
STRAND_FN Real edge_stiffness(Real stretch, Real rest_length) {
  return stretch / SELECT(rest_length > (Real)1e-15f, rest_length, (Real)1e-15f);
}

// The matrix by w, added to `a`.
STRAND_FN SYMMETRIC plus_load(SYMMETRIC a, VEC3 along, VEC3 edge, VEC3 load) {
  Real pull = inner(edge, load);
  Real tension = SELECT(pull > (Real)0.0f, pull, (Real)0.0f);
  VEC3 couple = outer(edge, load);
  Real size2 = inner(couple, couple);
  Real is_some = SELECT(size2 > (Real)1e-36f, (Real)1.0f, (Real)0.0f);
  Real size = SQRT(SELECT(size2 > (Real)1e-36f, size2, (Real)1.0f));
  Real share = (Real)0.5f * is_some;
  a = plus_diagonal(a, tension + share * size);
  a = plus_square(a, along, (Real)0.0f - tension);
  return plus_square(a, couple, (Real)0.0f - share / size);
}

STRAND_MATH_END
