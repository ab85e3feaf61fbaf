// What a solver did and what it could leave out.
#pragma once

namespace strandbake {

// How much there was to do since the solver was made, in blocks of strands and their substeps, and how much of it was
// skipped since it could not change a bit.
struct WorkCount {
  long long substeps = 0, substeps_at_rest = 0;
  long long spheres = 0, spheres_out_of_reach = 0;
};

}  // namespace strandbake
