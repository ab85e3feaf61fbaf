// A shot: a scene with its files opened. Groom placed and divided into regions, head and colliders ready to be sampled,
// and the plan of what will be run.
#pragma once

#include <Eigen/Geometry>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "formats/animation.h"
#include "formats/scene.h"
#include "sim/auto_substeps.h"
#include "sim/frame_input.h"
#include "sim/groom.h"
#include "sim/plan.h"

namespace strandbake {

// From the coordinates of a groom file to the world, or to the head node's axes where the groom was made there.
struct Placement {
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();  // with units and scale
  Eigen::Vector3d move = Eigen::Vector3d::Zero();      // [m]
  double size = 1;                                     // metres per unit of the file, scale included

  Eigen::Vector3d operator()(const Eigen::Vector3d& p) const { return turn * p + move; }
};

struct Shot {
  Scene scene;
  Groom groom;
  Plan plan;
  Placement placement;  // of what has no units or axes of its own
  Animation animation;  // without nodes where the scene has no animation
  std::size_t head_node = 0;
  std::vector<std::size_t> collider_node;                       // [colliders], where a collider rides one
  Eigen::Isometry3d head_rest = Eigen::Isometry3d::Identity();  // pose of the head node at the rest frame
  std::vector<Eigen::Isometry3d> collider_rest;                 // [colliders], the same of the nodes they ride
  std::vector<std::pair<std::string, std::string>> inputs;      // each file as the scene names it, and its sha256
  std::vector<std::uint16_t> auto_substeps;  // of each frame after the first, where bake.substeps is "auto"

  // Where a node of the animation stands at a scene frame.
  Eigen::Isometry3d pose(std::size_t node, double frame) const;
  // Head transform from the rest frame to a scene frame; exactly the identity where the head stands as at rest.
  Eigen::Isometry3d head(double frame) const;
  std::vector<Sphere> spheres(double frame) const;
  std::vector<RegionParams> regions(double frame) const;

  // How many substeps lead from frame - 1 to `frame`, the last of the scene at most. Before the first (pre-roll)
  // nothing moves, so there "auto" takes one.
  int substeps(int frame) const;
  // Of all frames that are simulated up to one.
  struct Substeps {
    int least = 0, most = 0;
    std::int64_t total = 0;
  };
  Substeps count_substeps(int last_frame) const;

  // What leads from frame - 1 to `frame`. Before the first frame of the scene (pre-roll) head, colliders and parameters
  // stand as in the first frame, while gusts blow on.
  FrameInput input(int frame) const;

  // Head and spheres at a scene frame, held before the first as in input().
  Motion motion(double frame) const;

 private:
  class Moment;
  Eigen::Isometry3d head(Moment& moment) const;
  std::vector<Sphere> spheres(Moment& moment) const;
};

// Opens everything that a scene names. Appends all that is wrong to `faults`; with faults the shot is of no use.
// `skip_idle`: as in plan_region.
Shot load_shot(Scene scene, Faults& faults, Warnings& warnings, bool skip_idle = true);

}  // namespace strandbake
