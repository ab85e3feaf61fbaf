// What the tests of the solver share beside the samples.
#pragma once

#include <cstring>

#include "samples/shots.h"

namespace strandbake::harness {

using namespace samples;

// Strands of every awkward kind, some pinned at their tip or in the middle.
inline Groom awkward_groom(const Vector3d& center) {
  Random random(21);
  Groom groom = mixed_groom(22, 21, 40, center);
  add_strand(groom, straight(2, 0.01, center));
  add_strand(groom, straight(3, 0.01, center));
  add_strand(groom, curly(70, 0.2, 0.02, 9, center));
  add_strand(groom, folded(9, 0.01, center));
  add_strand(groom, folded(30, 0.02, center + Vector3d(0.01, 0, 0)));
  add_strand(groom, stuttering(random, 33, center));
  add_strand(groom, stuttering(random, 8, center));
  add_strand(groom, Points(12, center));  // all in one place
  add_strand(groom, straight(20, 1e-4, center));
  pin(groom, 23, 69);
  pin(groom, 24, 5);
  for (std::size_t s = 0; s < 20; s += 4) pin(groom, s, groom.vertex_count(s) - 1);
  return groom;
}

inline Shot busy_shot() {
  Shot shot;
  shot.groom = awkward_groom({0, 0, 0});
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s)
    shot.groom.region.push_back(static_cast<std::uint32_t>(s % 4));
  shot.regions_at = [](int frame) {
    std::vector<RegionParams> regions(4);
    for (int r = 0; r < 4; ++r) {
      RegionParams& region = regions[static_cast<std::size_t>(r)];
      region.local = {0.2 + 0.1 * r + 0.01 * frame, 2 + r, r + 1};
      region.global = {0.1, 0.3 + 0.2 * r, 1};
    }
    return regions;
  };
  shot.wind = {{4, 0, 1}, 0.5, 0.2};
  shot.head = dance;
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.05, 0), 0.1}}; };
  shot.substeps_at = [](int frame) { return 1 + frame % 3; };
  shot.fps = 24;
  shot.frames = 15;
  return shot;
}

inline SolverOptions in_double() {
  return {.precision = Precision::Double};
}

inline bool same_bits(const Points& a, const Points& b) {
  return a.size() == b.size() && (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(Vector3d)) == 0);
}
}  // namespace strandbake::harness
