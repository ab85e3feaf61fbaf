#include "cli/draw/sheet.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <stdexcept>
#include <string>

#include "cli/draw/font.h"

namespace strandbake {
namespace {

constexpr int gutter = 4;  // [pixels]
constexpr float screen_shape = 1.7f;

int choose_columns(std::size_t count, int width, int height) {
  const double n = static_cast<double>(count);
  const int wanted = static_cast<int>(std::lround(std::sqrt(n * screen_shape * height / width)));
  const int columns = std::clamp(wanted, 1, static_cast<int>(count));
  // As few columns as so many rows need, so that the last row is well filled.
  const int rows = (static_cast<int>(count) + columns - 1) / columns;
  return (static_cast<int>(count) + rows - 1) / rows;
}

// The text, or its beginning and dots, such that it fits.
std::string cut_to(const std::string& text, float height, float width) {
  if (text_width(text, height) <= width) return text;
  std::string kept = text;
  while (!kept.empty() && text_width(kept + "...", height) > width) kept.pop_back();
  return kept + "...";
}

}  // namespace

Image make_contact_sheet(std::span<const SheetTile> tiles, const SheetOptions& options) {
  if (tiles.empty()) throw std::invalid_argument("a contact sheet needs at least one picture");
  if (options.columns < 0) throw std::invalid_argument("a contact sheet cannot have fewer than one column");
  const int width = tiles[0].image.width, height = tiles[0].image.height;
  for (const SheetTile& tile : tiles) {
    if (tile.image.width != width || tile.image.height != height || tile.image.pixel.empty()) {
      throw std::invalid_argument("the pictures of a contact sheet must all have the same size");
    }
  }
  const int count = static_cast<int>(tiles.size());
  const int columns =
      options.columns > 0 ? std::min(options.columns, count) : choose_columns(tiles.size(), width, height);
  const int rows = (count + columns - 1) / columns;

  const int page_width = gutter + columns * (width + gutter);
  const float title_height = std::clamp(static_cast<float>(page_width) / 90, 8.0f, 16.0f);
  const int strip = options.title.empty() ? 0 : static_cast<int>(std::lround(2.6f * title_height));
  Image page(page_width, strip + gutter + rows * (height + gutter), Eigen::Vector4f(0.006f, 0.007f, 0.009f, 1));
  if (strip > 0) {
    const float indent = gutter + title_height;
    draw_text(page, cut_to(options.title, title_height, static_cast<float>(page_width) - 2 * indent), indent,
              static_cast<float>(gutter + strip) / 2 - title_height / 2, title_height, {0.62f, 0.64f, 0.67f});
  }

  const float caption_height = std::clamp(static_cast<float>(height) / 34, 7.0f, 20.0f);
  for (int t = 0; t < count; ++t) {
    const int left = gutter + t % columns * (width + gutter), top = strip + gutter + t / columns * (height + gutter);
    const SheetTile& tile = tiles[static_cast<std::size_t>(t)];
    for (int y = 0; y < height; ++y) {
      std::copy_n(&tile.image.at(0, y), width, &page.at(left, top + y));
    }
    const std::string caption = std::to_string(tile.frame);
    const float x = static_cast<float>(left) + 1.2f * caption_height;
    const float y = static_cast<float>(top + height) - 2.2f * caption_height;
    draw_text(page, caption, x, y, caption_height, {0.75f, 0.77f, 0.80f});
  }
  return page;
}

}  // namespace strandbake
