#include "cli/draw/legend.h"

#include <algorithm>
#include <cmath>

#include "cli/draw/font.h"
#include "cli/draw/strands.h"

namespace strandbake {
namespace {

constexpr float scale_length = 9;  // all in heights of the text
constexpr float gap = 0.6f;
constexpr float between = 1.5f;
const Eigen::Vector3f ink(0.62f, 0.64f, 0.67f);

template <class ColorOf>
void fill(Image& image, float x, float y, float width, float height, const ColorOf& color_of) {
  const auto clip = [](float v, int side) {
    return static_cast<int>(std::clamp(std::round(v), 0.0f, static_cast<float>(side)));
  };
  for (int row = clip(y, image.height); row < clip(y + height, image.height); ++row) {
    for (int column = clip(x, image.width); column < clip(x + width, image.width); ++column) {
      const Eigen::Vector3f color = color_of((static_cast<float>(column) + 0.5f - x) / width);
      image.at(column, row) = {color.x(), color.y(), color.z(), 1};
    }
  }
}

// Light that is as bright as hair of the colour in the picture's light.
Eigen::Vector3f lit(const Eigen::Vector3f& color) {
  return tone_map(1.2f * color);
}

// Walks along the line: text(where, what), box(where, colour or scale). Returns the width.
template <class Text, class Swatch, class Scale>
float lay_out(const Legend& legend, float height, const Text& text, const Swatch& swatch, const Scale& scale) {
  float x = 0;
  const auto put = [&](const std::string& words, float space) {
    text(x, words);
    x += text_width(words, height) + space * height;
  };
  if (!legend.title.empty()) put(legend.title, between);
  for (const auto& [name, color] : legend.entries) {
    swatch(x, color);
    x += (1 + gap) * height;
    put(name, between);
  }
  if (legend.entries.empty() && !legend.empty()) {
    put(legend.low, gap);
    scale(x);
    x += (scale_length + gap) * height;
    put(legend.high, between);
  }
  return std::max(0.0f, x - between * height);
}

}  // namespace

float legend_width(const Legend& legend, float height) {
  const auto nothing = [](float, const auto&) {};
  return lay_out(legend, height, nothing, nothing, [](float) {});
}

void draw_legend(Image& image, const Legend& legend, float x, float y, float height) {
  lay_out(
      legend, height, [&](float at, const std::string& words) { draw_text(image, words, x + at, y, height, ink); },
      [&](float at, const Eigen::Vector3f& color) {
        fill(image, x + at, y, height, height, [&](float) { return lit(color); });
      },
      [&](float at) {
        fill(image, x + at, y, scale_length * height, height, [](float t) { return lit(scale_color(t)); });
      });
}

}  // namespace strandbake
