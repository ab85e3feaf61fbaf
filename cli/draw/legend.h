// What the colours of a picture mean.
#pragma once

#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

#include "cli/draw/canvas.h"

namespace strandbake {

struct Legend {
  std::string title;                                             // "stretch"
  std::vector<std::pair<std::string, Eigen::Vector3f>> entries;  // names and colours in linear light, or none
  std::string low, high;                                         // ends of the scale of scale_color(), or both empty

  bool empty() const { return entries.empty() && low.empty() && high.empty(); }
};

// Width [pixels] of a legend in one line whose capitals are `height` pixels tall.
float legend_width(const Legend& legend, float height);

// Draws it; x, y is the top left corner of its capitals [pixels]. What lies outside the image is cut off.
void draw_legend(Image& image, const Legend& legend, float x, float y, float height);

}  // namespace strandbake
