// Integration: Verlet with damping.
//
//   P' = P + k (P - Q) + a h^2                                       [m]
//
// P, Q position now and one substep ago, a acceleration [m/s^2], h substep [s]. k is the share of the velocity that is
// kept: 1 - c over 1/60 s, so (1 - c)^(60 h) over a substep, times h / h_before where the substep has changed.
// Source: paper, section 3.2.
// Checks: tests/sim/passes_test.cpp, tests/sim/motion_test.cpp (free fall against its closed form).
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN VEC3 integrate(VEC3 p, VEC3 q, Real keep, VEC3 accel_h2) {
  return p + (p - q) * keep + accel_h2;
}

STRAND_MATH_END
