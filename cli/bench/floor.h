// The least that a pass has to do, and the time below which a machine cannot do it.
#pragma once

#include "cli/bench/probe.h"
#include "cli/bench/workload.h"

namespace strandbake {

// Numbers are per vertex. What is read or written lies in memory once a frame, whatever the substeps, since a block
// runs all of them in cache; operations are those of one substep.
struct Work {
  double read = 0;        // numbers, not bytes
  double written = 0;     // numbers
  double operations = 0;  // + - * and comparisons
  double divisions = 0;
  double roots = 0;

  Work operator+(const Work& other) const;
  // As much arithmetic `times` over; what a later sweep reads lies in cache.
  Work repeated(double times) const;
};

namespace work {

Work integrate();
Work wind();
Work global_shape();  // of a vertex in the range
Work local_shape(int method, int iterations, bool reacts);
Work edge_lengths();
Work rod(int iterations);
Work direct_lengths();
Work sphere();
Work read();        // positions to the order of the groom
Work non_finite();  // the check for numbers that are none

}  // namespace work

// All passes of a frame.
Work work_of(const Workload& workload);

// The larger of bytes over bandwidth and operations over the peak of the arithmetic [s], of `substeps` substeps.
double floor_seconds(const Work& work, double vertices, int substeps, Precision precision, const Probes& probes);

}  // namespace strandbake
