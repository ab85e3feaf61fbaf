#include "sim/auto_substeps.h"

#include <algorithm>
#include <cmath>

#include "sim/measure.h"

namespace strandbake {

HairExtent hair_extent(const Groom& groom, const Plan& plan) {
  HairExtent extent;
  const std::vector<std::uint8_t> pinned = pinned_vertices(groom);
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    if (!plan.regions[groom.region.empty() ? 0 : groom.region[strand]].simulated) continue;
    double length = 0;
    for (std::size_t v = groom.offset[strand]; v < groom.offset[strand + 1]; ++v) {
      if (pinned[v]) extent.roots.extend(groom.position[v]);
      if (v > groom.offset[strand]) length += (groom.position[v] - groom.position[v - 1]).norm();
    }
    extent.reach = std::max(extent.reach, length);
  }
  return extent;
}

MotionNeed motion_need(std::span<const Motion> path, const HairExtent& hair) {
  MotionNeed need;
  if (hair.roots.isEmpty()) return need;
  constexpr double kSamples2 = kMotionSamples * kMotionSamples;
  for (std::size_t t = 1; t + 1 < path.size(); ++t) {
    for (int corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3d p = hair.roots.corner(static_cast<Eigen::AlignedBox3d::CornerType>(corner));
      const Eigen::Vector3d second = path[t + 1].head * p - 2 * (path[t].head * p) + path[t - 1].head * p;
      need.bend = std::max(need.bend, kSamples2 * second.norm());
    }
  }

  for (std::size_t s = 0; s < path.front().spheres.size(); ++s) {
    const auto in_head = [&](std::size_t t) -> Eigen::Vector3d {
      return path[t].head.inverse() * path[t].spheres[s].center;
    };
    bool is_near = false;
    double steps = 0;
    for (std::size_t t = 2; t < path.size(); ++t) {
      const double radius = std::max(path[t].spheres[s].radius, path[t - 1].spheres[s].radius);
      const Eigen::Vector3d now = in_head(t);
      const double way = (now - in_head(t - 1)).norm();
      // On its way it may come nearer by as much.
      is_near |= radius > 0 && hair.roots.exteriorDistance(now) <= hair.reach + radius + way;
      if (way > 0 && radius > 0) steps = std::max(steps, kMotionSamples * way / (radius / 2));
    }
    if (!is_near) continue;
    need.steps = std::max(need.steps, steps);
    for (std::size_t t = 1; t + 1 < path.size(); ++t) {
      const Eigen::Vector3d second =
          path[t + 1].spheres[s].center - 2 * path[t].spheres[s].center + path[t - 1].spheres[s].center;
      need.bend = std::max(need.bend, kSamples2 * second.norm());
    }
  }
  return need;
}

double SubstepCounter::next(const MotionNeed& need, double damping) {
  // Libraries differ in the last bit of a power; rounding hides it.
  const auto stays = static_cast<float>(std::pow(1 - damping, 60 / fps_));
  bend_ = std::max(need.bend, bend_ * stays);
  // What rounding makes of a path must not cost a substep.
  constexpr double kSlack = 1 + 1e-6;
  return std::max({1.0, std::ceil(std::sqrt(bend_ / (tolerance_ * kSlack))), std::ceil(need.steps / kSlack)});
}

}  // namespace strandbake
