// A small font of strokes: every letter, digit and the signs of file names, smooth at any size.
#pragma once

#include <Eigen/Core>
#include <string_view>

#include "cli/draw/canvas.h"

namespace strandbake {

// Width of a line of text [pixels] whose capitals are `height` pixels tall.
float text_width(std::string_view text, float height);

// Writes one line; x, y is the top left corner of its capitals [pixels], `color` linear light. UTF-8; what the font
// does not have becomes a box. Parts outside the image are cut off.
void draw_text(Image& image, std::string_view text, float x, float y, float height, const Eigen::Vector3f& color);

}  // namespace strandbake
