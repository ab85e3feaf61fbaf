// What the paper's stiffness means when the step is not 1/60 s.
//
// S moves a vertex by the share S of its error in a step of h0 = 1/60 s, as an implicit spring of compliance (1 - S)/S
// (in units of h0^2) would. At another step h the same spring gives
//
//   S_h = 1 / (1 + r (1 - S)/S) = S / (S + r (1 - S)),   r = (h0 / h)^2
//
// so S = 0 stays off, S = 1 stays rigid, and at h = h0 it is S.
// Source: ours; the compliance of Macklin, Mueller, Chentanez, "XPBD", MIG 2016, eq. 18, with one iteration.
// Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN Real stiffness_at_step(Real stiffness, Real step_ratio2) {
  return stiffness / (stiffness + step_ratio2 * ((Real)1.0f - stiffness));
}

STRAND_MATH_END
