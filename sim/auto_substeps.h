// bake.substeps = "auto": as many substeps in a frame as the motion of head and spheres needs. It depends on the input
// alone, so that it is the same on every backend and known before a bake. Source: ours.
//
// With the acceleration a [m/s^2] a root strays by a h^2 [m] from going straight on in a substep of h [s]. In a frame
// of T [s] the points p, which are the eight corners of the box around the pinned vertices, carried by the head, and
// the centres of the spheres, ask for
//   b = T^2 max |p(t + d) - 2 p(t) + p(t - d)| / d^2   [m],   d = T / kMotionSamples,
// where t runs over the frame in steps of d. Hair rings on for as long as its damping c lets it:
//   B = max(b, B of the frame before * (1 - c)^(60 T))   [m].
// The frame takes the smallest n >= 1 with B / n^2 <= tolerance, and with which no sphere moves against the head by
// more than half its radius in a substep. Spheres that hair cannot reach do not count.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <span>
#include <vector>

#include "sim/frame_input.h"
#include "sim/groom.h"
#include "sim/plan.h"

namespace strandbake {

// In a frame. More would find quicker turns, but read more into the corners of a path between key frames: a jump of the
// velocity by v counts as the acceleration v / d.
constexpr int kMotionSamples = 16;

// Head and spheres at one moment, as in FrameInput.
struct Motion {
  Eigen::Isometry3d head = Eigen::Isometry3d::Identity();
  std::vector<Sphere> spheres;
};

// Where simulated hair begins and how far it reaches, at rest; where iterated lengths stretch it, it reaches farther.
struct HairExtent {
  Eigen::AlignedBox3d roots;  // [m] around the pinned vertices; empty where no hair is simulated
  double reach = 0;           // [m] length of the longest strand
};
HairExtent hair_extent(const Groom& groom, const Plan& plan);

struct MotionNeed {
  double bend = 0;   // b [m]
  double steps = 0;  // substeps in which each sphere moves by half its radius
};
// `path`: kMotionSamples + 2 moments, from d before the frame's start to its end, each with the same spheres. Nothing
// is needed where no hair is simulated.
MotionNeed motion_need(std::span<const Motion> path, const HairExtent& hair);

// Goes through the frames of a bake in their order.
class SubstepCounter {
 public:
  // `tolerance` [m] > 0, `fps` [1/s] > 0.
  SubstepCounter(double tolerance, double fps) : tolerance_(tolerance), fps_(fps) {}

  // Substeps for the next frame, a whole number from 1, beyond any limit where motion jumps. `damping`: the least of
  // the simulated regions, c.
  double next(const MotionNeed& need, double damping);

 private:
  double tolerance_, fps_;
  double bend_ = 0;  // B
};

}  // namespace strandbake
