// What a solver needs to know to advance by one film frame.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <vector>

#include "sim/params.h"

namespace strandbake {

// A sphere that hair cannot enter, at one moment. Paper, section 3.5.
struct Sphere {
  Eigen::Vector3d center;  // world [m]
  double radius = 0;       // [m], >= 0
};

// The wind at one moment: four velocities [m/s], which each strand blends with weights of its own (gusts.h).
using WindSample = std::array<Eigen::Vector3d, 4>;

// All that changes from frame to frame. Vectors over substeps hold the moment at the END of each substep.
struct FrameInput {
  double substep = 0;                        // h [s], > 0
  std::vector<Eigen::Isometry3d> head;       // [substeps], rest frame to now, rigid: T_H
  std::vector<std::vector<Sphere>> spheres;  // [substeps][spheres], in the order in which they act
  std::vector<WindSample> wind;              // [substeps], or empty: no wind
  Eigen::Vector3d gravity{0, 0, 0};          // [m/s^2]
  std::vector<RegionParams> regions;         // [regions]

  std::size_t substeps() const { return head.size(); }
};

}  // namespace strandbake
