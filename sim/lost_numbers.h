// Where and when a strand has left the numbers. A solver looks for that at the end of a frame, which costs next to
// nothing; which substep it was, one strand tells that is simulated again alone.
#pragma once

#include <Eigen/Geometry>
#include <functional>
#include <optional>

#include "sim/plan.h"
#include "sim/solver.h"

namespace strandbake {

struct LostNumbers {
  std::size_t vertex;   // within the strand: the first that is not finite at the end of that substep, free ones first
  std::size_t substep;  // of the frame, from 1
};

// The frames that led to `last`, which ended with a strand that is not finite.
struct Replay {
  int first = 0, last = 0;               // the frame that hair starts in, and the one that went wrong
  std::function<FrameInput(int)> input;  // what leads from frame - 1 to `frame`, as the solver was given it
  Eigen::Isometry3d head_at_first;
  Precision precision = Precision::Float;
};

// Simulates the strand that a solver has found from the start, with the bits that it has among all others on a CPU.
// Empty where it stays finite: after a device that rounds otherwise. `groom` and `plan` as the solver was given them.
std::optional<LostNumbers> find_lost_numbers(const Groom& groom, const NonFinite& lost, const Plan& plan,
                                             const Replay& replay);

}  // namespace strandbake
