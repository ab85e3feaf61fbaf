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

// In the lower left corner of the part of the page that begins there.
float caption_size(int height) {
  return std::clamp(static_cast<float>(height) / 34, 7.0f, 20.0f);
}
void draw_frame_number(Image& page, int left, int top, int height, int frame) {
  const float size = caption_size(height);
  draw_text(page, std::to_string(frame), static_cast<float>(left) + 1.2f * size,
            static_cast<float>(top + height) - 2.2f * size, size, {0.75f, 0.77f, 0.80f});
}

}  // namespace

void annotate(Image& image, int frame, const Legend& legend) {
  draw_frame_number(image, 0, 0, image.height, frame);
  const float size = 0.8f * caption_size(image.height);
  const float x = static_cast<float>(image.width) - legend_width(legend, size) - 1.5f * size;
  draw_legend(image, legend, x, static_cast<float>(image.height) - 2.7f * size, size);
}

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
  const float indent = gutter + title_height;
  const float room = static_cast<float>(page_width) - 2 * indent;
  const float legend_room = options.legend.empty() ? 0 : legend_width(options.legend, title_height);
  const bool one_line = options.title.empty() || legend_room == 0 ||
                        text_width(options.title, title_height) + 2 * title_height + legend_room <= room;
  const int line = static_cast<int>(std::lround(2.6f * title_height));
  const int lines = options.title.empty() && options.legend.empty() ? 0 : one_line ? 1 : 2;
  const int strip = lines * line;
  Image page(page_width, strip + gutter + rows * (height + gutter), Eigen::Vector4f(0.006f, 0.007f, 0.009f, 1));
  const float text_top = static_cast<float>(gutter + line) / 2 - title_height / 2;
  if (!options.title.empty())
    draw_text(page, cut_to(options.title, title_height, room), indent, text_top, title_height, {0.62f, 0.64f, 0.67f});
  if (!options.legend.empty()) {
    const float x = one_line && !options.title.empty() ? static_cast<float>(page_width) - indent - legend_room : indent;
    draw_legend(page, options.legend, x, text_top + static_cast<float>(strip - line), title_height);
  }

  for (int t = 0; t < count; ++t) {
    const int left = gutter + t % columns * (width + gutter), top = strip + gutter + t / columns * (height + gutter);
    const SheetTile& tile = tiles[static_cast<std::size_t>(t)];
    for (int y = 0; y < height; ++y) {
      std::copy_n(&tile.image.at(0, y), width, &page.at(left, top + y));
    }
    draw_frame_number(page, left, top, height, tile.frame);
  }
  return page;
}

}  // namespace strandbake
