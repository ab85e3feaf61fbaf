// Edge length: holds a segment at its rest length.
//
//   C(P0, P1) = |P1 - P0| - L                                        [m]
//   n         = (P1 - P0) / |P1 - P0|,   grad C = (-n, +n)
//   P0 += w0/(w0 + w1) C n,   P1 -= w1/(w0 + w1) C n
//
// w is 1 for a free vertex and 0 for a pinned one: half and half, or all on the free one.
// Source: Mueller, Heidelberger, Hennix, Ratcliff, "Position Based Dynamics", 2007, eq. 10 and 11; paper, Algorithm 1
// line 9. Ours:   batches of even edges, then odd ones, on every backend. A segment shrunk to a point has no n and is
// left alone. Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

// C / |edge|, so that C n = edge times it.
STRAND_FN Real relative_length_error(VEC3 edge, Real rest_length) {
  Real length2 = inner(edge, edge);
  Real length = SQRT(SELECT(length2 > POINT_LENGTH_SQUARED, length2, (Real)1.0f));
  return SELECT(length2 > POINT_LENGTH_SQUARED, (length - rest_length) / length, (Real)0.0f);
}

// w / (w + other) for weights that are 0 or 1, and 0 where both are 0.
STRAND_FN Real edge_share(Real w, Real other) {
  return w * ((Real)1.0f - (Real)0.5f * other);
}

STRAND_MATH_END
