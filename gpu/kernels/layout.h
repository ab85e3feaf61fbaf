// What the host and the kernels agree on: where numbers stand in the buffers. C++ and OpenCL C.
#pragma once

#ifndef __OPENCL_C_VERSION__
#include <cstdint>
namespace strandbake {
typedef std::uint32_t uint;
#endif

// RegionStep (sim/block.h): its numbers, and its switches and counts.
enum RegionReal {
  kKeepFirst,
  kKeep,
  kTensionFirst,
  kGravityH2,                   // x, y, z
  kSupportH2 = kGravityH2 + 3,  // x, y, z
  kH2 = kSupportH2 + 3,
  kDragH2,
  kGlobalStiffness,
  kStepRatio2,
  kLocalStiffness,
  kRodBendH2,
  kRodTwistH2,
  kRodStretchH2,
  kRegionReals
};
enum RegionInt {
  kSupported,
  kWind,
  kGlobalShape,
  kLocalShape,
  kLocalMethod,
  kLocalIterations,
  kReacts,
  kDirectLengths,
  kLengthIterations,
  kRod,
  kRodIterations,
  kRegionInts
};

// Substep (sim/block.h).
enum SubstepReal { kRotation = 0, kMoves = 9, kMovedBefore = 12, kWindVelocity = 15, kSubstepReals = 27 };
enum SubstepInt { kSphereBegin, kSphereCount, kSubstepInts };

// Block (sim/block.h). Places are in numbers from the start of a batch's state; kAbsent: the plan left the array out.
#define kAbsent 0xffffffffu
typedef struct {
  uint vertices, region, simulated, masked, rides, global_end;
  uint position, previous, rest, root_frame, local_edge, remainder, lever, frame_x, frame_y, support;
  uint length, tension, rest_curvature, drawn, handed_back, pressed, fade, free, active, swept, elimination,
      wind_weight;
} BlockRow;

// What Block::elimination holds of a vertex: for direct lengths two numbers, for a rod these. Vectors are x, y, z.
enum RodScratch {
  kRodX = 0,        // where the iteration has it
  kRodWeight = 3,   // m of rod_link.h
  kRodFactors = 4,  // JointGain: yx, zx, zy, then the inverse of the diagonal
  kRodOwn = 10,     // where the vertex would have gone on its own, once the gains are used up
  kRodByX = 10,     // its matrices row by row
  kRodByW = 19,
  kRodOffset = 28,
  kRodExactRow = 31,  // so many numbers where lengths are exact
  kRodLength = 31,    // of the edge, now
  kStretchByX = 32,   // StretchGain
  kStretchByW = 35,
  kStretchOffset = 38,
  kRodStretchRow = 39
};
enum { kLengthRow = 2 };

// Where the strand of a lane goes in the output.
typedef struct {
  uint first, count;  // vertices; count 0: no strand in this lane
} Target;

#ifndef __OPENCL_C_VERSION__
}  // namespace strandbake
#endif
