#include "sim/lost_numbers.h"

#include <algorithm>
#include <cstdint>

namespace strandbake {
namespace {

// A line of so many vertices from corner to corner.
void add_line(Groom& groom, const Eigen::AlignedBox3d& box, std::size_t vertices, std::uint32_t region) {
  for (std::size_t i = 0; i + 1 < vertices; ++i) {
    groom.position.push_back(box.min() + box.sizes() * (static_cast<double>(i) / static_cast<double>(vertices - 1)));
  }
  groom.position.push_back(box.max());
  groom.offset.push_back(groom.position.size());
  groom.region.push_back(region);
}

// The strand under its own number, which gusts go by, in a groom of the same bounds, which the origin of positions goes
// by. Those before it are lines across the bounds that ride on the head, in a region of their own; one after it shares
// its block where that was masked.
Groom alone(const Groom& groom, const NonFinite& lost, std::uint32_t riding) {
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : groom.position) box.extend(p);
  Groom one;
  for (std::size_t s = 0; s < lost.strand; ++s) add_line(one, box, 2, riding);
  const std::uint32_t region = groom.region.empty() ? 0 : groom.region[lost.strand];
  const std::size_t own = groom.vertex_count(lost.strand);
  const std::size_t begin = groom.offset[lost.strand], first = one.position.size();
  for (std::size_t i = 0; i < own; ++i) one.position.push_back(groom.position[begin + i]);
  one.offset.push_back(one.position.size());
  one.region.push_back(region);
  add_line(one, box, lost.masked_to > own ? lost.masked_to : 2, lost.masked_to > 0 ? region : riding);
  if (groom.pinned.empty()) return one;
  one.pinned.resize(one.position.size(), 0);
  for (std::size_t i = 2; i < own; ++i) {
    one.pinned[first + i] = groom.pinned[begin + i];
    if (one.pinned[first + i] != 0) one.pinned.back() = 1;  // only those with pins share blocks with such
  }
  return one;
}

// Substep `s` as a frame of its own: an origin, a velocity and a step go from frame to frame as from substep to
// substep.
FrameInput only_substep(const FrameInput& frame, std::size_t s) {
  FrameInput one = frame;
  one.head = {frame.head[s]};
  if (!frame.spheres.empty()) one.spheres = {frame.spheres[s]};
  if (!frame.wind.empty()) one.wind = {frame.wind[s]};
  return one;
}

}  // namespace

std::optional<LostNumbers> find_lost_numbers(const Groom& groom, const NonFinite& lost, const Plan& plan,
                                             const Replay& replay) {
  Plan extended = plan;
  const auto riding = static_cast<std::uint32_t>(plan.regions.size());
  extended.regions.push_back({.simulated = false});
  const auto solver =
      make_openmp_solver(alone(groom, lost, riding), extended, replay.head_at_first, {.precision = replay.precision});
  RegionParams idle;
  idle.drag = idle.local.stiffness = idle.global.stiffness = 0;
  idle.lengths = LengthParams::iterated(0);
  for (int frame = replay.first + 1; frame <= replay.last; ++frame) {
    FrameInput input = replay.input(frame);
    input.regions.push_back(idle);
    if (frame < replay.last) {
      solver->advance(input);
      continue;
    }
    for (std::size_t s = 0; s < input.substeps(); ++s) {
      solver->advance(only_substep(input, s));
      const auto bad = solver->find_non_finite();
      if (!bad || bad->strand > lost.strand) continue;
      return LostNumbers{bad->strand == lost.strand ? bad->vertex : lost.vertex, s + 1};  // else the head is nowhere
    }
  }
  return std::nullopt;
}

}  // namespace strandbake
