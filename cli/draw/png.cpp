#include "cli/draw/png.h"

#include <png.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <system_error>
#include <vector>

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

  const std::string part = path.string() + ".part";
  const auto fail = [&](const char* what, int error) {
    throw DiskError(path.string() + ": cannot " + what + ": " + std::strerror(error));
  };
  std::FILE* file = std::fopen(part.c_str(), "wb");
  if (!file) fail("create the file", errno);
  int error = 0;
  if (std::fwrite(bytes.data(), 1, size, file) != size || std::fflush(file) != 0 || fsync(fileno(file)) != 0) {
    error = errno;
  }
  if (std::fclose(file) != 0 && error == 0) error = errno;
  const char* what = "write the file";
  if (error == 0 && std::rename(part.c_str(), path.c_str()) != 0) {
    error = errno;
    what = "give the file its name";
  }
  if (error != 0) {
    std::error_code ignored;
    std::filesystem::remove(part, ignored);
    fail(what, error);
  }
}

}  // namespace strandbake
