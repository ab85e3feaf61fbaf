// PNG files.
#pragma once

#include <filesystem>

#include "cli/draw/canvas.h"
#include "formats/error.h"

namespace strandbake {

// Writes the image as 8-bit sRGB without alpha, over black. The same image makes the same bytes. The file appears under
// its name only when it is whole: it is written beside it under another name first, and nothing is left behind where
// that fails. Throws DiskError, also for an image without pixels.
void write_png(const Image& image, const std::filesystem::path& path);

}  // namespace strandbake
