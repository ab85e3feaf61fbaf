// A contact sheet: pictures of several frames, side by side on one page.
#pragma once

#include <span>
#include <string>

#include "cli/draw/canvas.h"

namespace strandbake {

struct SheetTile {
  Image image;
  int frame = 0;  // the number in its corner
};

struct SheetOptions {
  std::string title;  // one line over the tiles, cut where it is too long; empty: none
  int columns = 0;    // 0: chosen so that the page is about as wide as a screen
};

// Tiles from left to right, then down. Throws std::invalid_argument where there is no tile, tiles differ in size, or
// columns are negative.
Image make_contact_sheet(std::span<const SheetTile> tiles, const SheetOptions& options);

}  // namespace strandbake
