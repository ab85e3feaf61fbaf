// Integration: Verlet with damping.
//
//   P' = P + k (P - Q) + a h^2                                       [m]
//
// P, Q position now and one substep ago, a acceleration [m/s^2], h substep [s]. k is the share of the velocity that is
// kept: 1 - c over 1/60 s, so (1 - c)^(60 h) over a substep, times h / h_before where the substep has changed.
// Positions are kept relative to an origin that travels with the head, so that float spends its digits on the hair and
// not on where the head is: world position = P + O, each P with the O of its own moment. With dO = O' - O the step
// ahead and dO_before = O - O_before the one behind, the same step reads
//
//   P' = P + k (P - Q) + a h^2 + (k dO_before - dO)
//
// Source: paper, section 3.2; the origin: ours.
// Checks: tests/sim/passes_test.cpp, tests/sim/motion_test.cpp (free fall against its closed form).
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN VEC3 integrate(VEC3 p, VEC3 q, Real keep, VEC3 accel_h2) {
  return p + (p - q) * keep + accel_h2;
}

// The part of the step that the origin makes.
STRAND_FN VEC3 shift_by_origin(VEC3 moves, VEC3 moved_before, Real keep) {
  return moved_before * keep - moves;
}

STRAND_MATH_END
