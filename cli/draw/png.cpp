#include "cli/draw/png.h"

#include <png.h>

#include <cstdint>
#include <span>
#include <vector>

#include "cli/draw/part_file.h"

namespace strandbake {

void write_png(const Image& image, const std::filesystem::path& path) {
  if (image.pixel.empty()) throw DiskError(path.string() + ": an image without pixels cannot be written as PNG");
  const std::vector<std::uint8_t> rows = to_rgb8(image);
  png_image png{};
  png.version = PNG_IMAGE_VERSION;
  png.width = static_cast<png_uint_32>(image.width);
  png.height = static_cast<png_uint_32>(image.height);
  png.format = PNG_FORMAT_RGB;
  png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(png);
  std::vector<std::uint8_t> bytes(size);
  if (!png_image_write_to_memory(&png, bytes.data(), &size, 0, rows.data(), 0, nullptr)) {
    throw DiskError(path.string() + ": libpng cannot encode the image: " + png.message);
  }

  PartFile file(path);
  file.write(std::as_bytes(std::span(bytes).first(size)));
  file.finish();
}

}  // namespace strandbake
