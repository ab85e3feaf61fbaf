// Collision: a vertex inside a sphere goes to the nearest point of its surface.
//
//   e = P - c,   |e| < r:   P = c + r e / |e|
//
// At the very centre every surface point is as near; the one above (+Y) is taken. Spheres act one after the other.
// Source: paper, section 3.5.
// Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

namespace strandbake {

// `free` is 1 for a vertex that may move, 0 for a pinned one.
STRAND_FN VEC3 push_out_of_sphere(VEC3 p, VEC3 center, Real radius, Real free) {
  VEC3 e = p - center;
  Real distance2 = inner(e, e);
  Real distance = SQRT(SELECT(distance2 > POINT_LENGTH_SQUARED, distance2, (Real)1.0f));
  // A vertex outside moves by exactly nothing.
  Real share = SELECT(distance2 < radius * radius, radius / distance - (Real)1.0f, (Real)0.0f) * free;
  Real lift =
      SELECT(distance2 < radius * radius, SELECT(distance2 > POINT_LENGTH_SQUARED, (Real)0.0f, radius), (Real)0.0f) *
      free;
  VEC3 out = p + e * share;
  out.y = out.y + lift;
  return out;
}

}  // namespace strandbake
