// Collision: a vertex inside a sphere goes to the nearest point of its surface.
//
//   e = P - c,   |e| < r:   P = c + r e / |e|
//
// At the very centre every surface point is as near; the one above (+Y) is taken. Spheres act one after the other.
// A vertex outside keeps its bits, so one that is known to be outside may be left out.
// Source: paper, section 3.5.
// Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN Real squared_distance(VEC3 p, VEC3 center) {
  VEC3 e = p - center;
  return inner(e, e);
}

// `free` is 1 for a vertex that may move, 0 for a pinned one.
STRAND_FN VEC3 push_out_of_sphere(VEC3 p, VEC3 center, Real radius, Real free) {
  VEC3 e = p - center;
  Real distance2 = squared_distance(p, center);
  Real distance = SQRT(SELECT(distance2 > POINT_LENGTH_SQUARED, distance2, (Real)1.0f));
  VEC3 moved = p + e * ((radius / distance - (Real)1.0f) * free);
  moved.y = moved.y + SELECT(distance2 > POINT_LENGTH_SQUARED, (Real)0.0f, radius) * free;
  return make_vec3(SELECT(distance2 < radius * radius, moved.x, p.x), SELECT(distance2 < radius * radius, moved.y, p.y),
                   SELECT(distance2 < radius * radius, moved.z, p.z));
}

// Squared distance from c to the box of corners low and high. Rounded in the order of squared_distance, so it is never
// more than that of a point in the box, to the last bit.
STRAND_FN Real squared_distance_to_box(VEC3 low, VEC3 high, VEC3 center) {
  VEC3 below = low - center;
  VEC3 above = center - high;
  VEC3 gap = make_vec3(SELECT(below.x > (Real)0.0f, below.x, SELECT(above.x > (Real)0.0f, above.x, (Real)0.0f)),
                       SELECT(below.y > (Real)0.0f, below.y, SELECT(above.y > (Real)0.0f, above.y, (Real)0.0f)),
                       SELECT(below.z > (Real)0.0f, below.z, SELECT(above.z > (Real)0.0f, above.z, (Real)0.0f)));
  return inner(gap, gap);
}

STRAND_MATH_END
