// Direct lengths: all segments of a strand brought to their rest lengths at once.
//
// First the tension T_j [m, as h^2 force / mass] that the substep before has found acts along the directions that come
// out of it, not along those that it finds (implicit Euler). Of it what the rounds below could not bear, as they are
// explicit: with a_j = max(T_j / L_j - 1/8, 0),
//
//   P_i + w_i (a_i (P_i - P_{i-1}) - a_{i+1} (P_{i+1} - P_i)) = P*_i
//
// Without it hair trembles where T_j / L_j is above 3/4 or so, that is, long hair of short segments. The system is
// tridiagonal, the same for x, y and z. Elimination from the root, with r = 1 - c,
//
//   m_i = 1 + w_i a_i r_{i-1} + w_i a_{i+1},   c_i = w_i a_{i+1} / m_i,   r_i = (1 + w_i a_i r_{i-1}) / m_i,
//   D_i = (P*_i + w_i a_i D_{i-1}) / m_i,   P_i = D_i + c_i P_{i+1}
//
// has no difference in it, so any tension is safe; where no a is above 0 it changes no bit. The first frame has none.
//
// Acting so, and in the rounds too, tension brakes: what swings across it at a rate w [1 / h] loses the share
// w^2 / (1 + w^2) of its energy in each substep, and the error falls with the root of the substep alone. So it is
// handed back before integration, by how segments have moved in the substep before, e_j = (P_j - Q_j) - (P_{j-1} -
// Q_{j-1}): with r_j = min(max(T_j / L_j, 0), 2), free vertices go on as if from
//
//   Q_i - 15/16 (r_i e_i - r_{i+1} e_{i+1})
//
// Then w^2 / 16 / (1 + w^2) is lost: never less than nothing, so it is stable at any rate. The bound of r is where a
// substep is longer than a swing.
//
// Then rounds of Newton's method on C = 0, with the weights w of edge_length.h. What they find, and what has acted
// already, is the next T. Where hair has lost its load, the latter is much less than T was, as segments have become
// short; where pins are too far apart they are long, and that must not add up.
//
//   C_j = |P_j - P_{j-1}| - L_j,   u_j = unit(P_j - P_{j-1})                                      [m]
//   A lambda = C,   A_jj = w_{j-1} + w_j,   A_{j-1,j} = A_{j,j-1} = -w_{j-1} u_{j-1} . u_j
//   P_j -= w_j (u_j lambda_j - u_{j+1} lambda_{j+1}),   T_j = a_j min(|P_j - P_{j-1}|, L_j) + sum of lambda_j
//
// A is tridiagonal: elimination from the root, substitution from the tip. With b_j = w_{j-1} u_{j-1} . u_j,
//
//   m_j = A_jj - b_j (b_j / m_{j-1}),   g_j = (C_j + b_j g_{j-1}) / m_j,   lambda_j = g_j + (b_{j+1} / m_j)
//   lambda_{j+1}
//
// A strand that is held by its root alone has m >= 1. Between two pinned vertices A can be singular, and no correction
// may exist: those segments have a compliance, which shares what is left among them.
// Newton may overshoot where a step is longer than a segment. So after the rounds one walk from the root makes each
// length exact where no pinned vertex follows,
//
//   e = P_j - P'_{j-1},   P'_j = P_j + (L_j - |e|) unit(e),
//
// which leaves every bit where lengths are what they should be. There a vertex that then lies in a sphere goes to the
// nearest point that is on the sphere and at its length from the vertex before.
// Source: the tridiagonal solve of Han, Harada, "Tridiagonal Matrix Formulation for Inextensible Hair Strand
// Simulation", VRIPHYS 2013; tension, rounds, walk, compliance and spheres: ours. Checks: tests/sim/passes_test.cpp,
// tests/sim/lengths_test.cpp.
#pragma once

#include "sim/passes/frame_scan.h"
#include "sim/passes/strand_math.h"

// Rounds of Newton's method in a substep.
#define LENGTH_ROUNDS 2

STRAND_MATH_BEGIN

// Added to A_jj between two pinned vertices.
#define HELD_COMPLIANCE ((Real)1e-3f)

// max(T / L, 0), from T of the substep before; `scale`: of the square of this one's length to that of it.
STRAND_FN Real tension_ratio(Real before, Real scale, Real rest_length) {
  Real length = SELECT(rest_length > (Real)1e-15f, rest_length, (Real)1.0f);
  return SELECT(before > (Real)0.0f, before * scale, (Real)0.0f) / length;
}

// a, from T / L.
STRAND_FN Real tension_pull(Real ratio) {
  Real beyond = ratio - (Real)0.125f;
  return SELECT(beyond > (Real)0.0f, beyond, (Real)0.0f);
}

// 15/16 r e, from T / L and e: what is handed back.
STRAND_FN VEC3 tension_return(Real ratio, VEC3 moved) {
  return moved * ((Real)0.9375f * SELECT(ratio < (Real)2.0f, ratio, (Real)2.0f));
}

// What has acted of T, along a segment that is so long now.
STRAND_FN Real tension_borne(Real pull, Real length, Real rest_length) {
  return pull * SELECT(length < rest_length, length, rest_length);
}

// 1 / m_i, from w_i a_i r_{i-1} and w_i a_{i+1}.
STRAND_FN Real tension_inverse(Real held, Real below) {
  return (Real)1.0f / (((Real)1.0f + below) + held);
}

// 0 for a point, which has no direction.
STRAND_FN Real segment_length(VEC3 edge) {
  Real length2 = inner(edge, edge);
  return SELECT(length2 > POINT_LENGTH_SQUARED, SQRT(length2), (Real)0.0f);
}

// u; next to nothing for a point.
STRAND_FN VEC3 segment_direction(VEC3 edge, Real length) {
  return edge * ((Real)1.0f / SELECT(length > (Real)0.0f, length, (Real)1.0f));
}

// C. A point is left alone.
STRAND_FN Real length_error(Real length, Real rest_length) {
  return SELECT(length > (Real)0.0f, length - rest_length, (Real)0.0f);
}

// Where the walk goes from `before`: along `direction`, that of far - before, for the rest length. Reckoned from the
// nearer of the two, so that rounding is as small as it can be.
STRAND_FN VEC3 at_length(VEC3 before, VEC3 far, VEC3 direction, Real rest_length) {
  Real missing = rest_length - segment_length(far - before);
  VEC3 from_far = far + direction * missing;
  VEC3 from_before = before + direction * rest_length;
  Real is_far = SELECT(missing * missing > rest_length * rest_length, (Real)1.0f, (Real)0.0f);
  return make_vec3(SELECT(is_far > (Real)0.0f, from_before.x, from_far.x),
                   SELECT(is_far > (Real)0.0f, from_before.y, from_far.y),
                   SELECT(is_far > (Real)0.0f, from_before.z, from_far.z));
}

// A_jj, from w_{j-1}, w_j and whether a pinned vertex ends the segment or comes after.
STRAND_FN Real segment_diagonal(Real w_near, Real w_far, Real held) {
  return w_near + w_far + HELD_COMPLIANCE * held;
}

// 1 / m_j, from A_jj, b_j and b_j / m_{j-1}. Padding has A_jj = 0; all else is above the bound, HELD_COMPLIANCE too.
STRAND_FN Real inverse_pivot(Real diagonal, Real b, Real share) {
  Real pivot = diagonal - b * share;
  return (Real)1.0f / SELECT(pivot > (Real)1e-4f, pivot, (Real)1.0f);
}

// The point nearest to `p` that is `length` from `near` and not in the sphere; `p` where it is such a point. Where none
// is out of the sphere, the one that is least deep. |p - near| = length.
STRAND_FN VEC3 swing_out_of_sphere(VEC3 p, VEC3 near, Real length, VEC3 center, Real radius) {
  VEC3 axis = center - near;
  Real distance2 = inner(axis, axis);
  Real distance = SQRT(SELECT(distance2 > POINT_LENGTH_SQUARED, distance2, (Real)1.0f));
  axis = axis * ((Real)1.0f / distance);
  // On the circle where the two spheres meet: as far along the axis, and across it where p is.
  Real along = (length * length + (distance2 - radius * radius)) / (distance + distance);
  along = SELECT(along < (Real)0.0f - length, (Real)0.0f - length, along);
  along = SELECT(along > length, length, along);  // by rounding alone, next to the centre
  Real across2 = length * length - along * along;
  Real across = SQRT(SELECT(across2 > (Real)0.0f, across2, (Real)0.0f));
  VEC3 arm = p - near;
  VEC3 side = arm - axis * inner(arm, axis);
  Real side2 = inner(side, side);
  // Straight at the centre all sides are as near.
  Real aside = SELECT(side2 > (Real)1e-6f * (length * length), (Real)1.0f, (Real)0.0f);
  side = side * (aside / SQRT(SELECT(side2 > POINT_LENGTH_SQUARED, side2, (Real)1.0f))) +
         frame_along(axis).y * ((Real)1.0f - aside);
  VEC3 out = near + axis * along + side * across;
  VEC3 e = p - center;
  Real moves = SELECT(inner(e, e) < radius * radius, distance2, (Real)0.0f);
  return make_vec3(SELECT(moves > POINT_LENGTH_SQUARED, out.x, p.x), SELECT(moves > POINT_LENGTH_SQUARED, out.y, p.y),
                   SELECT(moves > POINT_LENGTH_SQUARED, out.z, p.z));
}

STRAND_MATH_END
