// The plan: what a bake can ever need. Passes that do nothing in any frame are not run and get no memory.
#pragma once

#include <span>
#include <vector>

#include "sim/params.h"

namespace strandbake {

struct RegionPlan {
  bool simulated = true;  // else its hair rides on the head
  bool sag_free = false;
  bool rod = false;  // in place of local shape and edge lengths
  bool wind = false;
  bool global_shape = false;
  bool local_shape = false;
  bool edge_lengths = false;
  bool direct_lengths = false;  // only where edge_lengths holds: not iterated
  int local_method = 1;         // where local_shape holds
  bool reacts = false;          // its constraints have a reaction
  double global_range = 0;      // where global_shape holds; shares of the strand's length, constant over time
  double global_fade = 0;
  double rod_bend = 0, rod_twist = 0;  // where rod holds; B and C of passes/rod_bend.h [m^4/s^2]
  double rod_stretch = 0;              // Y of passes/rod_stretch.h [m^2/s^2]; 0: lengths are exact
};

struct Plan {
  std::vector<RegionPlan> regions;
  bool colliders = true;                     // false: no frame has any
  bool measured = false;                     // lengths are measured, also where nothing holds them
  Eigen::Vector3d gravity_at_rest{0, 0, 0};  // at the start [m/s^2], for sag-free regions
};

// Merges the parameters of a region over all frames of a bake. Range, fade, method and iterations do not move over
// time, so they are taken from the first. `windy`: the wind is not zero in every frame. `over_time` holds at least one
// entry. `skip_idle` false plans for passes that do nothing, too (Skip::passes).
RegionPlan plan_region(std::span<const RegionParams> over_time, bool windy, bool skip_idle = true);

}  // namespace strandbake
