// Lines with exact pixel coverage and exact order of depth.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <span>

#include "cli/draw/canvas.h"

namespace strandbake {

struct LinePoint {
  float x = 0;      // [pixels], as Camera::project
  float y = 0;      // [pixels]
  float depth = 0;  // [m] along the view, > 0
  float width = 0;  // [pixels], any size above 0: a line thinner than a pixel covers a part of it
  Eigen::Vector3f color{1, 1, 1};
};

// Draws polylines: points offset[i] .. offset[i + 1] - 1 belong to line i. Everything between two points is
// interpolated. A pixel receives the area that a segment covers in it as alpha, so a line of length l and width w adds
// up to l * w; what meets in a pixel is blended in order of depth, together with the solid thing that the canvas holds
// there. Segments with a point that is not finite, not in front of the eye, or more than 100,000 pixels away are left
// out. The bytes do not depend on the number of threads.
void draw_lines(Canvas& canvas, std::span<const LinePoint> points, std::span<const std::uint64_t> offset, int threads);

}  // namespace strandbake
