// The data of a block of W strands and of one frame, as the lane kernels see it. Plain pointers and numbers only: the
// kernels are compiled for several instruction sets and share no inline function with the rest of the program.
//
// Positions are relative to an origin that travels with the head (Origin in strand_blocks.h, passes/integrate.h).
// A value per vertex is stored as W numbers, one a strand; a vector as three such rows, x, y, z.
// Vertex i of an array of vectors begins at 3 W i. Strands that end early are padded with pinned vertices at the rest
// place of their tip, which no real vertex feels.
#pragma once

#include "sim/work_count.h"

namespace strandbake {

template <class Scalar>
struct Block {
  int vertices;        // of the longest strand in the block
  bool masked;         // some strand is pinned beyond its first two vertices, or shorter than `vertices`
  bool rides;          // not simulated: position is the rest position on the head, and previous the same memory
  int global_end;      // vertices [2, global_end) are in the range of the global shape
  int rest_vertices;   // of `rest`
  Scalar* position;    // [vertices] vectors: P
  Scalar* previous;    // [vertices] vectors: Q
  Scalar* rest;        // [rest_vertices] vectors: P0, as many as anything needs
  Scalar* root_frame;  // [2] vectors: x and y of the rest frame at the root
  Scalar* local_edge;  // [vertices] vectors: l (methods 1, 2 and 4)
  Scalar* remainder;   // [vertices] vectors: what rounding leaves of l (methods 1, 2 and 4)
  Scalar* lever;       // [vertices]: rho / L of local_shape.h (with a reaction)
  Scalar* frame_x;     // [vertices] vectors: frames of the last iteration (method 2; method 4, sag-free)
  Scalar* frame_y;
  Scalar* support;  // [vertices] vectors: c of support.h (methods 1, 2 and 4, sag-free)
  Scalar* length;   // [vertices]: L of the segment that ends at a vertex (where held or measured, or a reaction asks)
  Scalar* tension;  // [vertices] (direct lengths): T of that segment, as the last substep has found it
  Scalar* rest_curvature;  // [vertices] vectors: kappa0 of the joint before the segment that ends at a vertex (rod)
  Scalar* drawn;           // [vertices] vectors: A of rod_return.h, as the last substep has found it (rod)
  Scalar* handed_back;     // [vertices] vectors: what the next substep gets back of it (rod)
  Scalar* pressed;         // [vertices]: 1 where a sphere has pushed a vertex in the last substep (rod)
  Scalar* fade;            // [global_end]: w of the global shape
  Scalar* free;            // [vertices] if masked: 1 free, 0 pinned or padding
  Scalar* active;          // [vertices] if masked: 1 where the segment that ends at a vertex exists
  Scalar* swept;  // [vertices] if masked (direct, measured or a rod): 1 where no pinned vertex ends it or comes after
  Scalar* elimination;  // [vertices - 2] of as many numbers as are asked for: what a substep works out
  Scalar* wind_weight;  // [4]: blend of the four gusts
  bool at_rest;         // the last substep changed not a bit, and neither would another with the same input
};

// One moment at the end of a substep.
template <class Scalar>
struct Substep {
  Scalar rotation[9];      // of T_H, row by row
  Scalar moves[3];         // the origin of positions, in this substep [m]
  Scalar moved_before[3];  // and in the one before
  Scalar wind[12];         // four velocities [m/s]
  const Scalar* spheres;   // [sphere_count] of x, y, z (from the origin now), radius
  int sphere_count;
  bool repeats;  // all of the above is as it was in the substep before, be it of this frame or of the last; no move
};

// A region's parameters, made ready for the length of a substep.
template <class Scalar>
struct RegionStep {
  Scalar keep_first;                     // share of the velocity kept in the frame's first substep
  Scalar keep;                           // and in the others
  Scalar tension_first;                  // of the square of the frame's substep to that of the frame before
  Scalar gravity_h2[3];                  // [m]
  bool wind, global_shape, local_shape;  // which of them run
  bool supported;                        // by the frames of the hair
  Scalar support_h2[3];                  // else by the head: -g0 h^2 in the rest frame [m]; 0: not sag-free
  Scalar h2;                             // [s^2]
  Scalar drag_h2;                        // drag times h^2 [s]
  Scalar global_stiffness;               // S_G at 1/60 s
  Scalar step_ratio2;                    // (h0 / h)^2
  Scalar local_stiffness;                // S_L at this substep
  int local_iterations;
  int local_method;
  bool reacts;  // local constraints have a reaction
  bool direct_lengths;
  int length_iterations;  // 0 where direct
  bool rod;
  Scalar rod_bend_h2, rod_twist_h2;  // B h^2 and C h^2 of rod_bend.h [m^4]
  Scalar rod_stretch_h2;             // Y h^2 of rod_stretch.h [m^2]; 0: lengths are exact
  int rod_iterations;
  bool repeats;  // all of the above, but for what is kept of a velocity, is as it was in the last frame
};

// Numbers of a vertex in Workspace::rod.
constexpr int kRodRow = 34;

// What one thread needs beside the blocks, and what it counts.
template <class Scalar>
struct Workspace {
  Scalar* error;  // [vertices]: of edge lengths; direct lengths, g; rods, lengths of edges
  Scalar* share;  // [vertices]: local shape, |m| / |d|; direct lengths, c, then b / m; rods, weights
  Scalar* edge;   // [vertices] vectors: method 3, rest edges turned; direct lengths, u, then positions before the walk;
                  // rods, positions
  Scalar* frame_x;  // [vertices] vectors: method 4, x and y along the edges now; rods, P* (x)
  Scalar* frame_y;
  Scalar* old_frame_x;  // [vertices] vectors: frames before a substep, where blocks have them
  Scalar* old_frame_y;
  Scalar* old_tension;                // [vertices]: tension, or who is pressed, before a substep
  Scalar* twist;                      // [vertices] of two numbers: method 4, from those to the frames
  Scalar* rod;                        // [vertices] of kRodRow numbers, where a region is a rod: gains
  bool skip_colliders, skip_resting;  // see Skip
  WorkCount work;
};

// Runs all substeps of one frame on one block. `position` and `previous` change roles in every substep: after an odd
// number of them the new positions stand in `previous`.
template <class Scalar>
using AdvanceBlock = void (*)(Block<Scalar>& block, const RegionStep<Scalar>& region, const Substep<Scalar>* substeps,
                              int substep_count, Workspace<Scalar>& workspace);

struct LaneKernels {
  const char* name;
  int width_float;
  int width_double;
  AdvanceBlock<float> advance_float;
  AdvanceBlock<double> advance_double;
};
extern const LaneKernels kLanesSse2;
extern const LaneKernels kLanesAvx2;
extern const LaneKernels kLanesAvx512;

}  // namespace strandbake
