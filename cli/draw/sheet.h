// A contact sheet: pictures of several frames, side by side on one page.
#pragma once

#include <span>
#include <string>

#include "cli/draw/canvas.h"
#include "cli/draw/legend.h"

namespace strandbake {

struct SheetTile {
  Image image;
  int frame = 0;  // the number in its corner
};

struct SheetOptions {
  std::string title;  // one line over the tiles, cut where it is too long; empty: none
  Legend legend;      // beside the title, or below it where they are too long
  int columns = 0;    // 0: chosen so that the page is about as wide as a screen
};

// What a frame of a clip has in its lower corners: its number, and the legend.
void annotate(Image& image, int frame, const Legend& legend);

// Tiles from left to right, then down. Throws std::invalid_argument where there is no tile, tiles differ in size, or
// columns are negative.
Image make_contact_sheet(std::span<const SheetTile> tiles, const SheetOptions& options);

}  // namespace strandbake
