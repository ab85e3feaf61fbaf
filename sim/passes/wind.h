// Wind: what blows across the strand carries it along.
//
//   a = k (v - (v . t) t),   t = e / |e|                             [m/s^2]
//
// v wind [m/s], e segment towards the root [m], k drag of the region [1/s]. Air along the strand slides off.
// The wind of a strand is a blend of four gusts with weights of its own, so neighbours sway together but not alike; the
// gusts are functions of time alone (sim/gusts.h).
// Source: ours, after TressFX, where four winds around a cone are blended too.
// Checks: tests/sim/passes_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

STRAND_FN VEC3 wind_across(VEC3 wind, VEC3 segment) {
  Real length2 = inner(segment, segment);
  Real along = inner(wind, segment) / SELECT(length2 > POINT_LENGTH_SQUARED, length2, (Real)1.0f);
  return wind - segment * along;
}

STRAND_MATH_END
