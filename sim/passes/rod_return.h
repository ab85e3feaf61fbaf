// Rod: what implicit Euler brakes, handed back.
//
// A_k = P_k - P*_k is how far its rod has drawn a vertex from where it would have gone on its own, h^2 times the force
// over the mass, at the end of the substep. Acting so it brakes: a vibration of the rate w [1 / h] loses the share
// w^2 / (1 + w^2) of its energy in each substep. So a vertex goes on in the next substep as if from
//
//   Q_k + 7/8 (A_k - A_{k-1})
//
// Of the energy is lost w^2 / 8 / (1 + w^2) then: never less than nothing, so it is stable at any rate, and what is
// at rest stays there, as A does not change. The error of the step is an eighth. All of it handed back (second order),
// what a kink or a jerk has woken would ring for ever. (Edges are turned on as they turned, without it: rod_link.h.)
// A sphere's push is no vibration: nothing is handed back to a strand of which a vertex is within a quarter of an edge
// of a sphere, nor in the substep after, whose A_{k-1} counts as not known, or it bounces there for ever. Nor between
// two pinned vertices, where what is thrown too far is stretched. Source: ours; the same for tension alone is in
// direct_length.h. Checks: tests/validation/rod_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

// Of A of the substep before, from the square of this one's length to that of it: 0 where they have little in common,
// as rounding is not smaller in a short one.
STRAND_FN Real drawn_scale(Real longer2) {
  Real scale = SELECT(longer2 > (Real)4.0f, (Real)0.0f, longer2);
  return SELECT((Real)0.25f > longer2, (Real)0.0f, scale);
}

// `before`: A of the substep before, scaled to the length of this one; 0 where that is not known.
STRAND_FN VEC3 drawn_return(VEC3 drawn, VEC3 before) {
  Real is_known = SELECT(inner(before, before) > (Real)0.0f, (Real)0.875f, (Real)0.0f);
  Real is_drawn = SELECT(inner(drawn, drawn) > (Real)0.0f, is_known, (Real)0.0f);
  return (drawn - before) * is_drawn;
}

STRAND_MATH_END
