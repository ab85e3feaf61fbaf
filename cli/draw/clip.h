// Moving pictures.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "cli/draw/canvas.h"
#include "formats/error.h"

namespace strandbake {

// Takes the frames of a clip in their order. The file appears under its name only with finish(), and nothing of it is
// left behind without. All throw DiskError.
class ClipWriter {
 public:
  virtual ~ClipWriter() = default;
  // Rows from the top, three bytes of sRGB a pixel.
  virtual void add(std::span<const std::uint8_t> rgb) = 0;
  virtual void finish() = 0;
};

// A GIF that starts again when it ends, with one palette, chosen for the pixels of `sample` (three bytes each). Times
// are rounded to 1/100 s, not their sum. Throws std::invalid_argument for sides outside 1 .. 65535.
std::unique_ptr<ClipWriter> make_gif(const std::filesystem::path& path, int width, int height, double fps,
                                     std::span<const std::uint8_t> sample);

// An MP4 with H.264 video, by the program ffmpeg, which must be on the PATH. Both sides must be even; throws
// std::invalid_argument where they are not.
std::unique_ptr<ClipWriter> make_mp4(const std::filesystem::path& path, int width, int height, double fps);

}  // namespace strandbake
