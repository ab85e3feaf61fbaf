// Rod: vertices that lie on a sphere, in the same solve as everything else.
//
// A vertex that a sphere has pushed out would be pressed in again by its rod in the next step, and hair would tremble
// on the sphere. So a vertex that touches a sphere feels a spring along the normal n, k times as strong as its inertia,
//
//   k m (|e| - r)^2 / 2,   e = P - c,   n = e / |e|                                                      [m^3]
//
// with the matrix k m n n^T: what turns n is left out, as it would pull inwards; and a vertex farther inside than its
// edge is long is driven by that much. A strand of which a vertex touches a sphere gets one Newton iteration more. The
// first takes for touching what is nearer than a fiftieth of an edge, as hair that slides along a sphere leaves it a
// little in each step. In those after it vertices that are pulled away are off the surface, by so little as the spring
// is stiff, and free; those that are inside have been missed. In the end collision puts on the surface what is still
// inside.
// Source: ours. Checks: tests/sim/rod_test.cpp, tests/stability/stability_test.cpp.
#pragma once

#include "sim/passes/collide.h"
#include "sim/passes/rod_link.h"

STRAND_MATH_BEGIN

#define CONTACT_SHARE ((Real)1e4f)

// As shares of an edge: within which a vertex touches in the first iteration, and within which hair may bounce
// (rod_return.h).
#define TOUCH_MARGIN ((Real)0.02f)
#define BOUNCE_MARGIN ((Real)0.25f)

// Rounding leaves a vertex that touches as near to the surface as that. `length`: of its edge; `margin`: one of those
// above, or 0.
STRAND_FN Real touching_radius(Real radius, Real length, Real margin) {
  return radius * ((Real)1.0f + (Real)2e-6f) + length * margin;
}

// Of a vertex that touches. `mass`: 0 where it is pinned, or does not. `length`: of its edge.
STRAND_FN LINK with_contact(LINK v, VEC3 p, Real mass, VEC3 center, Real radius, Real length) {
  VEC3 e = p - center;
  Real distance2 = squared_distance(p, center);
  Real k = SELECT(distance2 > POINT_LENGTH_SQUARED, mass * CONTACT_SHARE, (Real)0.0f);
  Real distance = SQRT(SELECT(distance2 > POINT_LENGTH_SQUARED, distance2, (Real)1.0f));
  VEC3 n = e * ((Real)1.0f / distance);
  Real off = distance - radius;
  Real least = (Real)0.0f - length;
  v.A = plus_square(v.A, n, k);
  v.a = v.a + n * (k * SELECT(off > least, off, least));
  return v;
}

STRAND_MATH_END
