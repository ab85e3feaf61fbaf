// More of the stress table: real grooms on a real head that turns faster than any head does, from files that are not
// part of the project.
#pragma once

#include <filesystem>
#include <utility>
#include <vector>

#include "formats/animation.h"
#include "formats/groom_file.h"
#include "formats/procedural.h"
#include "samples/stability.h"

namespace strandbake::samples {

// A clip of the robot's head, whose joint is where the world has it in the first frame.
struct RobotHead {
  Animation animation;
  std::size_t node;

  RobotHead(const std::filesystem::path& assets, const std::string& clip) {
    Warnings warnings;
    // In units that make the robot's head as large as the grooms'.
    animation = read_animation(assets / "animation/robot_expressive.glb", {clip, "0.2", ""}, warnings);
    node = animation.find_node("Neck/Head");
  }
  Isometry3d pose(double time) const { return animation.pose(node, std::min(time, animation.duration)); }
};

// Every `step`-th strand of a .tfx, scaled and moved to the axes of the head's node.
inline void add_thinned(Groom& groom, const std::filesystem::path& file, std::size_t step, double scale,
                        const Vector3d& move, const Isometry3d& head) {
  Warnings warnings;
  const Groom all = read_groom(file, warnings);
  for (std::size_t s = 0; s < all.strand_count(); s += step) {
    Points points = points_of(all, s);
    for (Vector3d& p : points) p = head * (scale * p + move);
    add_strand(groom, points);
    for (std::size_t i = 0; !all.pinned.empty() && i < points.size(); ++i) {
      if (all.pinned[all.offset[s] + i]) pin(groom, groom.strand_count() - 1, i);
    }
  }
}

// Thinned, so that a case takes seconds. Throws InputError where a file is missing.
inline std::vector<Case> real_cases(const std::filesystem::path& assets) {
  std::vector<Case> all;
  const RobotHead head(assets, "Dance");
  const double end = head.animation.duration;
  const Vector3d move(0, -0.77, 0);  // the groom's head is centred 0.92 m up, the robot's 0.15 m above its joint
  Shot shot;
  shot.fps = 60;
  shot.substeps = 4;
  shot.frames = static_cast<int>(std::ceil(end * shot.fps)) + 210;
  const int stop = static_cast<int>(std::ceil(end * shot.fps));
  const Isometry3d rest = head.pose(0);
  shot.head = [head, rest](double time) { return head.pose(time) * rest.inverse(); };
  for (const char* const part : {"front_top", "side", "back", "tail"}) {
    add_thinned(shot.groom, assets / "ponytail" / (std::string(part) + ".tfx"), 100, 0.01, move, rest);
  }
  shot.spheres = [head, move](double time) {
    std::vector<Sphere> spheres = {
        {{-0.095, 92.0, 9.899}, 26.5}, {{-0.405, 93.707, -5.111}, 24.113}, {{-0.072, 68.548, -10.561}, 25.5}};
    for (Sphere& sphere : spheres) sphere = {head.pose(time) * (0.01 * sphere.center + move), 0.01 * sphere.radius};
    return spheres;
  };
  all.push_back({"a real ponytail at 1,501 degrees a second", shot, stop});
  shot.substeps = 1;
  all.push_back({"a real ponytail at 1,501 degrees a second, one substep", shot, stop});

  shot.spheres = {};
  shot.substeps = 4;
  shot.groom = {};
  add_thinned(shot.groom, assets / "mohawk/Ratboy_mohawk.tfx", 80, 1, {0, 0, 0}, rest);
  all.push_back({"a real mohawk with coincident vertices at 1,501 degrees a second", shot, stop});

  // On the head of formats/procedural.h, which has the size and the place of the grooms'.
  shot.substeps = 1;
  shot.groom = {};
  const Vector3d on_head(0, 0.15, 0);
  ProceduralParams curls = style_defaults("curly");
  curls.strands = 60;
  const Groom curly = make_groom(curls);
  for (std::size_t s = 0; s < curly.strand_count(); ++s) {
    Points points = points_of(curly, s);
    for (Vector3d& p : points) p = rest * (p + on_head);
    add_strand(shot.groom, points);
  }
  shot.spheres = [head, on_head](double time) {
    return std::vector<Sphere>{{head.pose(time) * on_head, 0.98 * head_radius}};
  };
  all.push_back({"curls on a head that dances, one substep", shot, stop});
  return all;
}

}  // namespace strandbake::samples
