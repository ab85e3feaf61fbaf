#include "cli/draw/font.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "cli/draw/raster.h"

namespace strandbake {
namespace {

// Strokes, separated by commas: points x, y of one sign each (0 .. 9, a = 10 .. g = 16), y downward. Capitals reach
// from 0 to c, small letters from 4, tails to g. A stroke that begins with ~ is the quadratic B-spline of its points.
struct Glyph {
  char letter;
  const char* strokes;
};
constexpr Glyph glyphs[] = {
    {' ', ""},
    {'0', "~40 80 86 8c 4c 0c 06 00 40"},
    {'1', "03 40 4c"},
    {'2', "~03 00 40 80 84 47 0c,0c 8c"},
    {'3', "~02 00 40 80 86 36,~36 86 8c 4c 0c 0a"},
    {'4', "6c 60 08 88"},
    {'5', "80 10 05,~05 24 84 8c 4c 0c 0a"},
    {'6', "~70 30 03 08,~08 0c 4c 8c 88 84 44 04 08"},
    {'7', "00 80 3c"},
    {'8', "~40 80 86 46 06 00 40,~46 86 8c 4c 0c 06 46"},
    {'9', "~1c 5c 89 84,~84 80 40 00 04 08 48 88 84"},
    {'A', "0c 40 8c,18 78"},
    {'B', "00 0c,~00 60 80 86 66 06,~06 66 86 8c 6c 0c"},
    {'C', "~82 80 40 00 06 0c 4c 8c 8a"},
    {'D', "00 0c,~00 40 80 86 8c 4c 0c"},
    {'E', "70 00 0c 7c,06 66"},
    {'F', "70 00 0c,06 66"},
    {'G', "~82 80 40 00 06 0c 4c 8c 87,87 57"},
    {'H', "00 0c,80 8c,06 86"},
    {'I', "00 0c"},
    {'J', "60 68,~68 6c 3c 0c 0a"},
    {'K', "00 0c,80 07,35 8c"},
    {'L', "00 0c 7c"},
    {'M', "0c 00 48 80 8c"},
    {'N', "0c 00 8c 80"},
    {'O', "~50 a0 a6 ac 5c 0c 06 00 50"},
    {'P', "0c 00,~00 60 80 87 67 07"},
    {'Q', "~50 a0 a6 ac 5c 0c 06 00 50,69 ad"},
    {'R', "0c 00,~00 60 80 87 67 07,47 8c"},
    {'S', "~82 80 40 00 05 87 8c 4c 0c 0a"},
    {'T', "00 80,40 4c"},
    {'U', "00 08,~08 0c 4c 8c 88,88 80"},
    {'V', "00 4c 80"},
    {'W', "00 3c 63 9c c0"},
    {'X', "00 8c,80 0c"},
    {'Y', "00 46 80,46 4c"},
    {'Z', "00 80 0c 8c"},
    {'a', "~05 04 34 74 77,77 7c,~77 37 07 0c 3c 7c 79"},
    {'b', "00 0c,~44 74 78 7c 4c 0c 08 04 44"},
    {'c', "~75 74 34 04 08 0c 3c 7c 7b"},
    {'d', "70 7c,~34 74 78 7c 3c 0c 08 04 34"},
    {'e', "08 78,~78 74 34 04 08 0c 3c 6c 7b"},
    {'f', "~60 20 22 25,25 2c,04 54"},
    {'g', "74 7d,~7d 7g 4g 1g 0f,~34 74 78 7c 3c 0c 08 04 34"},
    {'h', "00 0c,~08 04 44 74 78,78 7c"},
    {'i', "04 0c,00 01"},
    {'j', "34 3d,~3d 3g 0g,30 31"},
    {'k', "00 0c,64 09,37 7c"},
    {'l', "00 0c"},
    {'m', "04 0c,~08 04 34 64 68,68 6c,~68 64 94 c4 c8,c8 cc"},
    {'n', "04 0c,~08 04 44 74 78,78 7c"},
    {'o', "~44 84 88 8c 4c 0c 08 04 44"},
    {'p', "04 0g,~44 74 78 7c 4c 0c 08 04 44"},
    {'q', "74 7g,~34 74 78 7c 3c 0c 08 04 34"},
    {'r', "04 0c,~08 04 44 54"},
    {'s', "~65 64 34 04 07 69 6c 3c 0c 0b"},
    {'t', "20 29,~29 2c 5c,04 54"},
    {'u', "04 08,~08 0c 3c 7c 78,74 7c"},
    {'v', "04 3c 74"},
    {'w', "04 3c 65 9c c4"},
    {'x', "04 7c,74 0c"},
    {'y', "04 4c,84 2g"},
    {'z', "04 74 0c 7c"},
    {'.', "0b 0c"},
    {',', "1b 0e"},
    {':', "05 06,0b 0c"},
    {'-', "07 57"},
    {'_', "0e 8e"},
    {'/', "0d 60"},
    {'(', "~30 04 09 3d"},
    {')', "~00 34 39 0d"},
    {'+', "07 87,43 4b"},
    {'=', "05 75,09 79"},
    {'%', "90 0c,~20 40 44 04 00 20,~78 98 9c 5c 58 78"},
};
constexpr const char* missing = "00 80 8c 0c 00";
constexpr float units_per_height = 12;
constexpr float gap = 3.2f;  // between two letters
constexpr float space = 5;   // width of a blank
constexpr float stroke_width = 1.5f;

const char* strokes_of(char letter) {
  const auto* found =
      std::find_if(std::begin(glyphs), std::end(glyphs), [&](const Glyph& g) { return g.letter == letter; });
  return found == std::end(glyphs) ? missing : found->strokes;
}

int digit(char c) {
  return c >= 'a' ? c - 'a' + 10 : c - '0';
}

float glyph_width(const char* strokes) {
  int width = 0;
  for (const char* c = strokes; *c; ++c) {
    if (*c == '~' || *c == ',' || *c == ' ') continue;
    width = std::max(width, digit(*c));
    ++c;
  }
  return *strokes ? static_cast<float>(width) : space;
}

using Stroke = std::vector<Eigen::Vector2f>;

// The quadratic B-spline of control points that begins in the first and ends in the last.
Stroke smooth(const Stroke& control) {
  Stroke curve = {control.front()};
  for (std::size_t k = 1; k + 1 < control.size(); ++k) {
    const Eigen::Vector2f from = k == 1 ? control[0] : Eigen::Vector2f((control[k - 1] + control[k]) / 2);
    const Eigen::Vector2f to =
        k + 2 == control.size() ? control[k + 1] : Eigen::Vector2f((control[k] + control[k + 1]) / 2);
    constexpr int pieces = 8;
    for (int p = 1; p <= pieces; ++p) {
      const float t = static_cast<float>(p) / pieces;
      curve.push_back((1 - t) * (1 - t) * from + 2 * t * (1 - t) * control[k] + t * t * to);
    }
  }
  return curve;
}

template <class F>
void visit_strokes(const char* strokes, F f) {
  for (const char* c = strokes; *c;) {
    const bool round = *c == '~';
    if (round) ++c;
    Stroke stroke;
    for (; *c && *c != ','; ++c) {
      if (*c == ' ') continue;
      stroke.emplace_back(static_cast<float>(digit(c[0])), static_cast<float>(digit(c[1])));
      ++c;
    }
    if (*c == ',') ++c;
    f(round ? smooth(stroke) : stroke);
  }
}

// Calls f(strokes, x of the left edge [units]) for each letter and returns the width of all [units].
template <class F>
float lay_out(std::string_view text, F f) {
  float x = 0;
  for (char c : text) {
    if ((static_cast<unsigned char>(c) & 0xC0) == 0x80) continue;  // not the first byte of a letter
    const char* strokes = strokes_of(c);
    f(strokes, x);
    x += glyph_width(strokes) + gap;
  }
  return std::max(0.0f, x - gap);
}

}  // namespace

float text_width(std::string_view text, float height) {
  return height / units_per_height * lay_out(text, [](const char*, float) {});
}

void draw_text(Image& image, std::string_view text, float x, float y, float height, const Eigen::Vector3f& color) {
  const float scale = height / units_per_height;
  // A canvas of its own, no larger than the text, placed on whole pixels.
  const int border = static_cast<int>(std::ceil(height / 2)) + 2;
  const int left = static_cast<int>(std::floor(x)) - border, top = static_cast<int>(std::floor(y)) - border;
  Canvas canvas(static_cast<int>(std::ceil(text_width(text, height))) + 2 * border + 1,
                static_cast<int>(std::ceil(height)) + 2 * border + 1);
  std::vector<LinePoint> points;
  std::vector<std::uint64_t> offset = {0};
  lay_out(text, [&](const char* strokes, float at) {
    visit_strokes(strokes, [&](const Stroke& stroke) {
      for (const Eigen::Vector2f& p : stroke) {
        points.push_back({x - static_cast<float>(left) + scale * (at + p.x()),
                          y - static_cast<float>(top) + scale * p.y(), 1, scale * stroke_width, color});
      }
      offset.push_back(points.size());
    });
  });
  draw_lines(canvas, points, offset, 1);
  for (int row = std::max(0, -top); row < std::min(canvas.image.height, image.height - top); ++row) {
    for (int column = std::max(0, -left); column < std::min(canvas.image.width, image.width - left); ++column) {
      const Eigen::Vector4f over = canvas.image.at(column, row);
      Eigen::Vector4f& under = image.at(column + left, row + top);
      under = Eigen::Vector4f(over + (1 - over[3]) * under);
    }
  }
}

}  // namespace strandbake
