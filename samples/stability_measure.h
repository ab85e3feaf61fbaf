// What must hold of any shot, whatever is asked of the solver.
#pragma once

#include <optional>
#include <vector>

#include "samples/stability.h"
#include "sim/measure.h"

namespace strandbake::samples {

// What a shot came to. Lengths are those of segments that are held from the root alone, but for `held`.
struct Measured {
  bool finite = true;
  double stretch = 0;     // largest error of a length, as a share of what rounding may do to it
  double reach = 0;       // farthest from the last pinned vertex, as a share of the way along the strand at rest
  double held = 0;        // largest error of a length between two pinned vertices, as a share of the length
  double growth = 0;      // highest speed later than a second after the stop, as a share of the highest in that second
  double unrest = 0;      // farthest that a vertex goes in one of the last ten frames, as a share of the longest strand
  double elongation = 0;  // largest error of a length, as a share of it; of more than a thousandth of the strand
  std::optional<int> steps_to_rest;  // substeps from the stop until no frame goes beyond kUnrest any more
};

// Bounds that a test holds them to.
constexpr double kGrowth = 2;  // flutter goes up and down
constexpr double kUnrest = 5e-4;
constexpr double kHeld = 0.02;

// What rounding may do to a length. Positions are rounded as far from the groom's centre as a substep may have thrown
// them, and once more where they are read in the world; beside that, 1e-5 of the length in float and 1e-12 in double.
struct Allowance {
  double share = 0;  // of the length
  double size = 0;   // of the groom [m]
  double world = 0;  // [m]
  double rounding = 0;

  Allowance(const Groom& groom, Precision precision) {
    Eigen::AlignedBox3d box;
    for (const Vector3d& p : groom.position) box.extend(p);
    size = box.diagonal().norm();
    world = (box.center().norm() + 1e5) * 0x1p-52;
    const bool in_float = precision == Precision::Float;
    share = in_float ? 1e-5 : 1e-12;
    rounding = in_float ? 0x1p-22 : 0x1p-50;
  }
  // `thrown`: how far hair may have been thrown from where it was [m].
  double error(double length, double thrown) const { return share * length + rounding * (size + thrown) + world; }
};

inline Measured measure(const Case& c, Precision precision, const std::vector<Points>& taken) {
  Measured found;
  const Groom& groom = c.shot.groom;
  const Allowance allowance(groom, precision);
  const std::vector<std::uint8_t> pinned = pinned_vertices(groom);
  for (const Points& now : taken) {
    for (const Vector3d& p : now) found.finite = found.finite && p.allFinite();
  }
  if (!found.finite) return found;

  double longest = 0;
  std::vector<double> rest(groom.vertex_count(), 0), total(groom.strand_count(), 0);
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    for (std::size_t v = groom.offset[s] + 1; v < groom.offset[s + 1]; ++v)
      total[s] += rest[v] = (groom.position[v] - groom.position[v - 1]).norm();
    longest = std::max(longest, total[s]);
  }

  std::vector<double> speed(taken.size(), 0);  // [m] a frame
  for (std::size_t f = 1; f < taken.size(); ++f) speed[f] = largest_distance(taken[f], taken[f - 1]);

  // By forces alone, in a frame of one step.
  const double fall = (c.shot.gravity.norm() + c.shot.wind.velocity.norm()) / (c.shot.fps * c.shot.fps);
  for (std::size_t f = 1; f < taken.size(); ++f) {
    const Points& now = taken[f];
    const double thrown = 2 * std::max(speed[f], speed[f - 1]) + fall;
    for (std::size_t s = 0; s < groom.strand_count(); ++s) {
      std::size_t held = groom.offset[s] + 1;
      for (std::size_t v = held; v < groom.offset[s + 1]; ++v) {
        if (pinned[v]) held = v;
      }
      for (std::size_t v = groom.offset[s] + 2; v <= held; ++v)
        found.held = std::max(found.held, std::abs((now[v] - now[v - 1]).norm() / rest[v] - 1));
      double way = 0, allowed = 0;
      for (std::size_t v = held + 1; v < groom.offset[s + 1]; ++v) {
        const double error = allowance.error(rest[v], thrown);
        if (rest[v] > 1e-3 * total[s])
          found.elongation = std::max(found.elongation, std::abs((now[v] - now[v - 1]).norm() / rest[v] - 1));
        way += rest[v];
        allowed += error;
        found.stretch = std::max(found.stretch, std::abs((now[v] - now[v - 1]).norm() - rest[v]) / error);
        found.reach = std::max(found.reach, (now[v] - now[held]).norm() / (way + allowed));
      }
    }
  }

  const auto highest = [&](std::size_t from, std::size_t to) {
    return *std::max_element(speed.begin() + static_cast<std::ptrdiff_t>(from),
                             speed.begin() + static_cast<std::ptrdiff_t>(to));
  };
  if (c.stop == kNever) return found;
  const auto stopped = static_cast<std::size_t>(c.stop) + 2;
  const std::size_t later = stopped + static_cast<std::size_t>(std::max(std::ceil(c.shot.fps), 10.0));
  // Slower than a hundred-thousandth of a strand a frame is rest.
  found.growth = highest(later, taken.size()) / std::max(highest(stopped, later), 1e-5 * longest);
  found.unrest = highest(taken.size() - 10, taken.size()) / longest;
  std::size_t moving = taken.size() - 1;  // the last frame that goes too far
  while (moving > stopped && speed[moving] <= kUnrest * longest) --moving;
  if (found.unrest <= kUnrest) {
    found.steps_to_rest = 0;
    for (std::size_t f = stopped + 1; f <= moving; ++f)
      *found.steps_to_rest += substeps_of(c.shot, static_cast<int>(f));
  }
  return found;
}

}  // namespace strandbake::samples
