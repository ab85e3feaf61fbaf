// The picture of a hairstyle.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "cli/draw/camera.h"
#include "cli/draw/canvas.h"
#include "cli/draw/shape.h"

namespace strandbake {

struct StrandsView {
  std::span<const Eigen::Vector3f> position;  // [vertices], world [m]
  std::span<const std::uint64_t> offset;      // [strands + 1] as Groom::offset; empty: no strand
  std::span<const std::uint32_t> region;      // [strands], or empty: all in region 0
  std::span<const Shape> shapes;              // colliders, the head
  std::span<const float> value;               // [vertices], 0 .. 1 of scale_color(), in place of regions; or empty
};

struct DrawOptions {
  float strand_width = 0;  // [m]; 0: natural_width() of the positions at hand, which differs from frame to frame
  int threads = 1;         // >= 1; has no influence on the picture
};

// Draws smooth curves through the vertices of each strand. Strands with a vertex that is not finite or lies beyond
// `farthest` are left out. Throws std::invalid_argument where the sizes of the spans contradict each other.
Image draw_strands(const StrandsView& strands, const Camera& camera, const DrawOptions& options);

// The width [m] at which so many strands cover their scalp about as hair does: few are drawn thick, many fine. Take it
// from the rest pose and use it for all frames.
float natural_width(std::span<const Eigen::Vector3f> position, std::span<const std::uint64_t> offset);

// Adds what a camera should see of one frame: the hair but for what flew away, and the shapes unless they are larger
// than three times the hair. All is moved by -shift.
void frame_strands(const StrandsView& strands, const Eigen::Vector3f& shift, Framing& framing);

// The colour of a region's hair in linear light: eight natural ones, then again from the first.
Eigen::Vector3f region_color(std::uint32_t region);

// The colour of a measured value in linear light: from blue at 0 over green and yellow to red at 1 and beyond; what is
// no number is as 1.
Eigen::Vector3f scale_color(float value);

}  // namespace strandbake
