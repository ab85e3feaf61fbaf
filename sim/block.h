// The data of a block of W strands and of one frame, as the lane kernels see it. Plain pointers and numbers only: the
// kernels are compiled for several instruction sets and share no inline function with the rest of the program.
//
// A value per vertex is stored as W numbers, one a strand; a vector as three such rows, x, y, z. Vertex i of an array
// of vectors begins at 3 W i. Strands that end early are padded with pinned vertices at the rest place of their tip,
// which no real vertex feels.
#pragma once

namespace strandbake {

template <class Scalar>
struct Block {
  int vertices;        // of the longest strand in the block
  bool masked;         // some strand is pinned beyond its first two vertices, or shorter than `vertices`
  int global_end;      // vertices [2, global_end) are in the range of the global shape
  Scalar* position;    // [vertices] vectors: P
  Scalar* previous;    // [vertices] vectors: Q
  Scalar* rest;        // [rest_vertices] vectors: P0, as many as anything needs
  Scalar* root_frame;  // [2] vectors: x and y of the rest frame at the root
  Scalar* local_edge;  // [vertices] vectors: l (methods 1 and 2)
  Scalar* remainder;   // [vertices] vectors: what rounding leaves of l (methods 1 and 2)
  Scalar* frame_x;     // [vertices] vectors: frames of the last iteration (method 2)
  Scalar* frame_y;
  Scalar* length;       // [vertices]: L of the segment that ends at a vertex
  Scalar* fade;         // [global_end]: w of the global shape
  Scalar* free;         // [vertices] if masked: 1 free, 0 pinned or padding
  Scalar* active;       // [vertices] if masked: 1 where the segment that ends at a vertex exists
  Scalar* wind_weight;  // [4]: blend of the four gusts
};

// One moment at the end of a substep.
template <class Scalar>
struct Substep {
  Scalar rotation[9];  // T_H, row by row
  Scalar translation[3];
  Scalar wind[12];        // four velocities [m/s]
  const Scalar* spheres;  // [sphere_count] of x, y, z, radius
  int sphere_count;
};

// A region's parameters, made ready for the length of a substep.
template <class Scalar>
struct RegionStep {
  Scalar keep_first;            // share of the velocity kept in the frame's first substep
  Scalar keep;                  // and in the others
  Scalar gravity_h2[3];         // [m]
  Scalar drag_h2;               // drag times h^2 [s]; 0: no wind
  Scalar global_stiffness;      // S_G at 1/60 s; 0: off
  Scalar step_ratio2;           // (h0 / h)^2
  Scalar half_local_stiffness;  // S_L / 2 at this substep; 0: off
  int local_iterations;
  int local_method;
  int length_iterations;
};

// Runs all substeps of one frame on one block. `position` and `previous` change roles in every substep: after an odd
// number of them the new positions stand in `previous`.
template <class Scalar>
using AdvanceBlock = void (*)(const Block<Scalar>& block, const RegionStep<Scalar>& region,
                              const Substep<Scalar>* substeps, int substep_count);

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
