// Local shape: keeps bends and curls, by frames that travel along the strand.
//
//   x_i = unit(P_i - P_{i-1})
//   F_i = smallest rotation from x_{i-1} to x_i, applied to F_{i-1}
//   g   = F_{i-1} l_i,           l_i = F0_{i-1}^T (P0_i - P0_{i-1})        the edge as the rest pose has it
//   d   = g - (P_i - P_{i-1})
//   P_{i-1} -= 1/2 S_L d,   P_i += 1/2 S_L d
//
// The paper composes F_i = F_{i-1} rotation((1,0,0) -> F_{i-1}^T x_i); that is the same rotation, and in the world it
// needs no quaternion: with y . x_{i-1} = 0,
//
//   y_i = y - (y . x_i) / (1 + x_{i-1} . x_i) (x_{i-1} + x_i)
//
// Scaled by the edge e of length L, one division serves both the unit vector and the turn: with k = L + x_{i-1} . e
// and r = 1/(L k),   x_i = (r k) e,   y_i = y - r (y . e) (L x_{i-1} + e).
// (y_i . x_i) vanishes whatever (y . x_{i-1}) was, so rounding does not pile up along a strand.
// As it stands in the paper the constraint turns hair about and nothing turns against it: its couple, e_i x d, is lost,
// and with many substeps or iterations hair flutters, also at rest. With a reaction (ours, methods 1, 2 and 4) the
// edge before takes it, as the gradient of the energy d^2 / 2 has it, but for the twist, which no edge can take. With
// S, L the stiffness and rest lengths, x and G = F_{i-1} l_i the direction and the goal,
//
//   m = S / (2 + S (W - 2)) d,   g = (G (x . m) - m (x . G)) / L_{i-1},   W = 1 + w_{i-1} (1 + rho)^2 + w_{i-2} rho^2
//   P_{i-2} -= w_{i-2} g,   P_{i-1} += w_{i-1} (g - m),   P_i += w_i m,   rho = L_i / L_{i-1}, at most 4, w: 1 free, 0
//   not
//
// so that |m| is what the paper's compliance, (1 - S) / S for each of two vertices, makes of the weight W of a free
// vertex i. Constraints run in three batches then, i = 2, 5, ..., i = 3, 6, ... and i = 4, 7, ... Where the strand
// folds back on itself (k near 0) any half turn will do: y stays, less what of it is not across x_i. Where the edge is
// a point, F stays. Source: paper, eq. 1 and 4 (the first line of eq. 4 lacks its minus in print), Algorithms 2 to 5;
// reaction: ours. Checks: tests/sim/frames_test.cpp (against quaternions), tests/sim/passes_test.cpp,
// tests/sim/paper_test.cpp.
#pragma once

#include "sim/passes/strand_math.h"

STRAND_MATH_BEGIN

// 1 + cos of the angle below which a strand counts as folded back: 0.8 degrees short of a half turn. Nearer to it the
// division would cost a float y more than a thousandth of its length.
#define FOLDED_BACK ((Real)1e-4f)

STRAND_FN FRAME turn_frame(FRAME f, VEC3 edge) {
  Real length2 = inner(edge, edge);
  Real length = SQRT(SELECT(length2 > POINT_LENGTH_SQUARED, length2, (Real)1.0f));
  Real k = length + inner(f.x, edge);
  Real safe_k = SELECT(k > FOLDED_BACK * length, k, length);
  Real r = (Real)1.0f / (length * safe_k);
  VEC3 x = edge * (r * safe_k);
  Real turn = SELECT(length2 > POINT_LENGTH_SQUARED, r * inner(f.y, edge), (Real)0.0f);
  VEC3 y = f.y - (f.x * SELECT(k > FOLDED_BACK * length, length, (Real)0.0f) + edge) * turn;
  FRAME to;
  to.x =
      make_vec3(SELECT(length2 > POINT_LENGTH_SQUARED, x.x, f.x.x), SELECT(length2 > POINT_LENGTH_SQUARED, x.y, f.x.y),
                SELECT(length2 > POINT_LENGTH_SQUARED, x.z, f.x.z));
  to.y = y;
  return to;
}

// From the frame's axes to the world.
STRAND_FN VEC3 from_frame(FRAME f, VEC3 v) {
  return f.x * v.x + f.y * v.y + outer(f.x, f.y) * v.z;
}

// From the world to the frame's axes.
STRAND_FN VEC3 into_frame(FRAME f, VEC3 v) {
  return make_vec3(inner(f.x, v), inner(f.y, v), inner(outer(f.x, f.y), v));
}

// d of the vertex at the far end of `edge`. `remainder` is what rounding leaves of the rest pose, rest edge minus
// from_frame(rest frame, l) in this very arithmetic; with it a strand at rest has d = 0 exactly and not a bit moves.
STRAND_FN VEC3 local_shape_error(FRAME f, VEC3 local_rest_edge, VEC3 remainder, VEC3 edge) {
  return (from_frame(f, local_rest_edge) - edge) + remainder;
}

// rho / L_i: 1 / L_{i-1}, at most 4 / L_i. 0 for a point, which carries no frame.
STRAND_FN Real shape_lever(Real length_before, Real length) {
  Real most = (Real)4.0f * SELECT(length_before > (Real)1e-15f, length_before, (Real)0.0f);
  Real longer = SELECT(most > length, length_before, (Real)0.25f * length);
  return SELECT(most > (Real)0.0f, (Real)1.0f, (Real)0.0f) / SELECT(longer > (Real)1e-15f, longer, (Real)1.0f);
}

// W - 2, for a free vertex i.
STRAND_FN Real shape_weight(Real rho, Real free_near, Real free_before) {
  Real near = (Real)1.0f + rho;
  return (free_near * (near * near) + free_before * (rho * rho)) - (Real)1.0f;
}

// |m| / |d|, from W - 2.
STRAND_FN Real shape_share(Real stiffness, Real weight) {
  return stiffness / ((Real)2.0f + stiffness * weight);
}

// g
STRAND_FN VEC3 shape_reaction(FRAME f, VEC3 local_rest_edge, VEC3 move, Real lever) {
  return (from_frame(f, local_rest_edge) * inner(f.x, move) - move * local_rest_edge.x) * lever;
}

STRAND_MATH_END
