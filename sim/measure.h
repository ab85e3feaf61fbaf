// Figures of a frame, measured on the positions of the solver (before a cache rounds them).
#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "sim/frame_input.h"
#include "sim/groom.h"

namespace strandbake {

// Rest length [m] of the segment that ends at each vertex, 0 at roots.
std::vector<float> rest_lengths(const Groom& groom);

// The vertices [first, last) of a groom.
struct VertexRange {
  std::size_t first;
  std::size_t last;
};

// Largest |length / rest length - 1| over the segments that end in `range`; segments shorter than 1e-5 m at rest do not
// count: a metre from the origin, float positions cannot tell their length to a hundredth. In float: right to a few
// 1e-7 of the length, and infinite beyond 1e19 m.
float largest_stretch(std::span<const Eigen::Vector3f> position, std::span<const float> rest_length, VertexRange range);

// How deep the deepest free vertex of `range` lies inside a sphere [m]; 0 where none does. `pinned` as
// pinned_vertices() gives it.
float deepest_penetration(std::span<const Eigen::Vector3f> position, std::span<const std::uint8_t> pinned,
                          std::span<const Sphere> spheres, VertexRange range);

// 1 for each vertex that follows the head: the first two of a strand and what the groom pins.
std::vector<std::uint8_t> pinned_vertices(const Groom& groom);

}  // namespace strandbake
