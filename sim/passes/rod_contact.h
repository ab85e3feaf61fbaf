// Rod: vertices that lie on a sphere, in the same solve as everything else.
//
// A vertex that a sphere has pushed out would be pressed in again by its rod in the next step, and hair would tremble
// on the sphere. So a vertex that touches a sphere feels a spring along the normal n, k times as strong as its inertia,
//
//   k m (|e| - r)^2 / 2,   e = P - c,   n = e / |e|                                                      [m^3]
//
// with the matrix k m n n^T: what turns n is left out, as it would pull inwards; and a vertex farther inside than its
// edge is long is driven by that much. Who touches is not asked for anew in each substep, or it would change from one
// to the next for ever and hair tremble: it is who was pushed in the last iteration, be it of this substep or of the
// one before, as long as it is nearer than a fiftieth of an edge, since hair that slides along a sphere leaves it a
// little in each step; and who is inside. An iteration lets go of what its spring pulls back, else hair stuck to
// spheres, and the more so the shorter the step: the spring's length is asked for by how the iteration has moved the
// vertex, as |e| - r itself is less than rounding. A strand that touches a sphere gets one Newton iteration more, and
// others up to CONTACT_ITERATIONS as long as somebody is let go or missed in them. In the end collision puts on the
// surface what is still inside. Source: ours. Checks: tests/sim/rod_test.cpp, tests/stability/stability_test.cpp.
#pragma once

#include "sim/passes/collide.h"
#include "sim/passes/rod_link.h"

STRAND_MATH_BEGIN

#define CONTACT_SHARE ((Real)1e4f)
#define CONTACT_ITERATIONS 3

// As shares of an edge: within which a vertex may go on touching, and within which hair may bounce
// (rod_return.h).
#define TOUCH_MARGIN ((Real)0.02f)
#define BOUNCE_MARGIN ((Real)0.25f)

// `length`: of its edge; `margin`: one of those above.
STRAND_FN Real touching_radius(Real radius, Real length, Real margin) {
  return radius + length * margin;
}
// Inside which a vertex is not for rounding alone, nor for what a push by 1 mm/s^2 does in a step: hair that rests on a
// sphere would tremble if a vertex were caught by so little.
STRAND_FN Real missed_radius(Real radius, Real h2) {
  Real inner = radius - (radius * OF_PRECISION(1e-6f, 1e-11f) + h2 * (Real)1e-3f);
  return SELECT(inner > (Real)0.0f, inner, (Real)0.0f);
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

// Length of the spring [m] once an iteration has moved the vertex, which was at p, by so much: below 0 it pushes.
STRAND_FN Real contact_length(VEC3 p, VEC3 moved, VEC3 center, Real radius, Real length) {
  VEC3 e = p - center;
  Real distance2 = squared_distance(p, center);
  Real distance = SQRT(SELECT(distance2 > POINT_LENGTH_SQUARED, distance2, (Real)1.0f));
  Real off = distance - radius;
  Real least = (Real)0.0f - length;
  return SELECT(off > least, off, least) + inner(e, moved) * ((Real)1.0f / distance);
}

STRAND_MATH_END
