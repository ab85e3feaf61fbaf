// The animation of a head for scenes of the benchmarks.
#pragma once

#include <string>

namespace strandbake {

// A BVH file with one joint, "Head", at the origin, that turns and sways from frame to frame as the benchmarks of the
// solver have it (workload.h).
std::string swaying_head_bvh(int frames, double fps);

}  // namespace strandbake
