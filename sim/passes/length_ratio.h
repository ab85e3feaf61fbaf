// How long a segment is, as it is measured for the statistics of a frame.
//
//   (|edge| / L)^2        1: at rest
//
// Segments shorter than 1e-5 m at rest count as at rest: float positions on a head cannot tell their length to a
// hundredth. Squared, so that a root is drawn once for many.
// Checks: tests/sim/measure_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN Real squared_length_ratio(VEC3 edge, Real rest_length) {
  return SELECT(rest_length < (Real)1e-5f, (Real)1.0f, inner(edge, edge) / (rest_length * rest_length));
}

STRAND_MATH_END
