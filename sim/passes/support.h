// Support: hair that rests where the artist put it (sag-free).
//
// A groom is modelled as it hangs; that is its weight in balance with what the hair bends with. That inner force goes
// with the strand. In the frame before vertex i, with g0 the gravity that the rest pose is in balance with,
//
//   c_i = -F0_{i-1}^T g0,      a_i = g + F_{i-1} c_i                                               [m/s^2]
//
// On a head that stands as it did at the start, a strand in its rest pose feels nothing. One that has swung away feels
// how its weight and its inner force have come apart. Where frames do not follow the hair (method 3, no local shape)
// F is the head's rotation. Frames of methods 2 and 4 stand still while a region's local shape is switched off.
// Source: ours. The problem: Twigg, Kacic-Alesic, "Optimization for Sag-Free Simulations", SCA 2011.
// Checks: tests/sim/support_test.cpp.
#pragma once

#include "sim/passes/local_shape.h"
#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

// What the inner force adds to a h^2 [m].
STRAND_FN VEC3 supported(FRAME f, VEC3 support, Real h2) {
  return from_frame(f, support) * h2;
}

STRAND_MATH_END
