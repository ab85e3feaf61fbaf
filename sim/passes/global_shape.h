// Global shape: a vertex returns to its place on the head.
//
//   P_i += S_G(i) (T_H P0_i - P_i)
//
// T_H head transform from the rest frame to now, P0 rest position. S_G fades from the root to the end of its range:
// S_G(i) = S_G w_i, with w_i = 1 - fade s_i / range at the arc length s_i (as a share of the strand) up to the range, 0
// beyond. Source: paper, eq. 2. Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN VEC3 pull_to_goal(VEC3 p, VEC3 goal, Real stiffness) {
  return p + (goal - p) * stiffness;
}

STRAND_MATH_END
