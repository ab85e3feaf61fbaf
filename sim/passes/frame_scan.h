// The frames of local_shape.h for a whole strand at once, from its positions alone.
//
//   x_i = unit(P_i - P_{i-1}),   that of the root where the edge is a point
//   B_i = (x_i, b_i, c_i)        a frame that depends on x_i alone;  B_1 = F_1, the frame of the root
//   z_i = cos a + i sin a        a: from b_i to what the smallest rotation from x_{i-1} to x_i makes of b_{i-1}
//   Z_i = z_i z_{i-1} ... z_2
//   F_i = (x_i, y_i, z),   y_i = Re Z_i b_i + Im Z_i c_i
//
// A smallest rotation keeps the angle about x between what it carries, so all that can differ between F_i and B_i is
// an angle about x_i, and these angles add up along the strand: a product of complex numbers of length 1. Z_i is found
// for all i in log2 n rounds, each on the numbers that the round before left:
//
//   for d = 1, 2, 4, ...:   Z_i <- Z_i Z_{i-d}   for all i >= 2 + d
//
// starting with z_i. That order of products is part of the result, on every backend. Rounds with a larger d change
// nothing, so Z_i does not depend on what comes after vertex i.
// Where the strand folds back on itself any half turn will do, as in local_shape.h: b_{i-1} stays.
// Source: rounds of Hillis, Steele, "Data Parallel Algorithms", CACM 29(12), 1986; B of Duff, Burgess, Christensen,
// Hery, Kensler, Liani, Villemin, "Building an Orthonormal Basis, Revisited", JCGT 6(1), 2017; frames as a product of
// plane rotations: ours.
// Checks: tests/sim/frames_test.cpp (against turn_frame), tests/sim/passes_test.cpp, tests/sim/paper_test.cpp.
#pragma once

#include "sim/passes/local_shape.h"
#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN VEC3 direction_or(VEC3 edge, VEC3 of_a_point) {
  Real length2 = inner(edge, edge);
  VEC3 x = edge * ((Real)1.0f / SQRT(SELECT(length2 > POINT_LENGTH_SQUARED, length2, (Real)1.0f)));
  return make_vec3(SELECT(length2 > POINT_LENGTH_SQUARED, x.x, of_a_point.x),
                   SELECT(length2 > POINT_LENGTH_SQUARED, x.y, of_a_point.y),
                   SELECT(length2 > POINT_LENGTH_SQUARED, x.z, of_a_point.z));
}

// B of the unit vector x: its y is the X axis, turned as the nearer of +Z and -Z is turned to x.
STRAND_FN FRAME frame_along(VEC3 x) {
  Real nearer = SELECT(x.z < (Real)0.0f, (Real)-1.0f, (Real)1.0f);
  Real across = nearer * x.x;
  Real share = across / (nearer + x.z);
  FRAME f;
  f.x = x;
  f.y = make_vec3((Real)1.0f - x.x * share, (Real)0.0f - x.y * share, (Real)0.0f - across);
  return f;
}

// z of the vertex with the frame `here`.
STRAND_FN TWIST twist_between(FRAME before, FRAME here) {
  Real k = (Real)1.0f + inner(before.x, here.x);
  Real turn = inner(before.y, here.x) / SELECT(k > FOLDED_BACK, k, (Real)1.0f);
  // Less what lies along here.x, which neither b nor c sees.
  VEC3 y = before.y - before.x * SELECT(k > FOLDED_BACK, turn, (Real)0.0f);
  TWIST t;
  t.re = inner(y, here.y);
  t.im = inner(y, outer(here.x, here.y));
  return t;
}

STRAND_FN TWIST twist_product(TWIST a, TWIST b) {
  TWIST t;
  t.re = a.re * b.re - a.im * b.im;
  t.im = a.re * b.im + a.im * b.re;
  return t;
}

// F of the vertex with the frame B.
STRAND_FN FRAME twisted_frame(FRAME along, TWIST t) {
  FRAME f;
  f.x = along.x;
  f.y = along.y * t.re + outer(along.x, along.y) * t.im;
  return f;
}

STRAND_MATH_END
