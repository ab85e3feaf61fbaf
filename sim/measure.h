// Figures of a frame, measured in the solver's own numbers: relative to its origin, which travels with the head, so
// that they are as good far from the origin of the world as at it.
#pragma once

#include <cstdint>
#include <vector>

#include "sim/block.h"
#include "sim/groom.h"

namespace strandbake {

// Of all hair that is simulated; what rides on the head neither stretches nor gives way. All 0 where there is none.
struct Figures {
  // Largest |length / rest length - 1| of a segment; those shorter than 1e-5 m at rest do not count. Infinite in float
  // beyond 1e19 m.
  float largest_stretch = 0;
  // The same of the segments that a pinned vertex beyond them holds at both ends: no walk from the root can set their
  // lengths, and where the pinned vertices are too far apart for them, nothing can.
  float residual = 0;
  // How deep the deepest free vertex lies inside a sphere [m].
  float deepest_penetration = 0;

  void include(const Figures& other);
};

// Of one block of strands. `now`: its newest positions. `width`: strands side by side in it. `spheres`: x, y, z,
// relative to the same origin, and radius.
template <class Scalar>
Figures measure_block(const Block<Scalar>& block, const Scalar* now, int width, const Scalar* spheres,
                      int sphere_count);

// 1 for each vertex that follows the head: the first two of a strand and what the groom pins.
std::vector<std::uint8_t> pinned_vertices(const Groom& groom);

}  // namespace strandbake
