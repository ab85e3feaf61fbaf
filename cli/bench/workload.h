// What the benchmarks simulate: a groom on a head that turns and sways, with spheres that go along.
#pragma once

#include <memory>

#include "cli/bench/timing.h"
#include "gpu/opencl_solver.h"
#include "sim/frame_input.h"
#include "sim/groom.h"
#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {

struct Workload {
  std::shared_ptr<const Groom> groom;
  RegionParams params;
  WindParams wind;  // zero: no wind
  int regions = 1;  // with the same parameters, strands dealt out to them in turn
  int spheres = 0;  // the head first, then others within the hair
  int substeps = 1;

  bool windy() const { return !wind.velocity.isZero(0) && params.drag > 0; }
  Plan plan() const;
  // 60 frames a second.
  FrameInput input(int frame) const;
};

// Everything off: vertices fly, and the first two of each strand follow the head.
RegionParams nothing_but_integration();

// The groom with only every so manieth strand, so that `share` of them are left, at least one.
Groom thinned(const Groom& groom, double share);

// A solver in the middle of its shot.
class SolverRun {
 public:
  SolverRun(const Workload& workload, const SolverOptions& options);
  SolverRun(const Workload& workload, const Device& device, const OpenCLOptions& options);

  // Advances by one frame; the seconds that Solver::advance took, or the device's kernels by its own clock.
  double frame();
  // As many frames as take about `seconds`, each a sample, after one that does not count.
  Turn turn(double seconds);
  const Solver& solver() const { return *solver_; }

 private:
  Workload workload_;
  std::unique_ptr<Solver> solver_;
  const OpenCLSolver* on_device_ = nullptr;
  int frame_ = 0;
};

}  // namespace strandbake
