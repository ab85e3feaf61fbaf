// Rods of all kinds, and hair of other methods beside them.
#pragma once

#include "tests/sim/harness.h"

namespace strandbake::harness {

inline RegionParams rod_region(bool exact_lengths, int iterations) {
  RegionParams region;
  region.method = "rod";
  region.rod.exact_lengths = exact_lengths;
  region.rod.iterations = iterations;
  return region;
}

// Each awkward strand in each region.
inline Shot rod_shot() {
  Shot shot = busy_shot();
  const Groom once = shot.groom;
  constexpr std::uint32_t kRegions = 6;
  shot.groom = {};
  for (std::uint32_t r = 0; r < kRegions; ++r) {
    for (std::size_t s = 0; s < once.strand_count(); ++s) {
      add_strand(shot.groom, points_of(once, s));
      shot.groom.region.push_back(r);
      for (std::size_t v = 0; v < once.vertex_count(s); ++v) {
        if (once.pinned[once.offset[s] + v] != 0) pin(shot.groom, shot.groom.strand_count() - 1, v);
      }
    }
  }
  shot.regions_at = [](int frame) {
    std::vector<RegionParams> regions = {rod_region(true, 1), rod_region(true, 3), rod_region(false, 1),
                                         rod_region(false, 3)};
    regions.resize(kRegions);
    regions[0].global.stiffness = regions[3].global.stiffness = 0;
    regions[1].global = {0.1 + 0.02 * frame, 0.6, 0.5};
    regions[1].sag_free = regions[2].sag_free = true;
    regions[2].rod.stiffness = 30;
    regions[3].rod.radius = 2e-4;
    regions[4].local.method = 1;
    regions[4].sag_free = true;
    regions[5].local = {0.3, 2, 3};
    regions[5].lengths = LengthParams::iterated(2);
    return regions;
  };
  shot.frames = 6;
  return shot;
}

}  // namespace strandbake::harness
