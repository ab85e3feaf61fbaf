// Pictures in linear light, and the way from there to the bytes of a screen.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

namespace strandbake {

// Rows from the top, pixels from the left. RGBA: linear light, 0 .. 1 on a screen, colours premultiplied with alpha.
struct Image {
  int width = 0;
  int height = 0;
  std::vector<Eigen::Vector4f> pixel;

  Image() = default;
  // Throws std::invalid_argument where a side is negative.
  Image(int width, int height, const Eigen::Vector4f& fill = Eigen::Vector4f::Zero());

  std::size_t index(int x, int y) const { return static_cast<std::size_t>(y) * static_cast<std::size_t>(width) + x; }
  Eigen::Vector4f& at(int x, int y) { return pixel[index(x, y)]; }
  const Eigen::Vector4f& at(int x, int y) const { return pixel[index(x, y)]; }
};

// A picture in the making: what solid things have left in each pixel, and how far away they are. Colours may exceed 1.
struct Canvas {
  Image image;
  std::vector<float> depth;  // [m] along the view; infinity where there is nothing solid

  Canvas(int width, int height)
      : image(width, height), depth(image.pixel.size(), std::numeric_limits<float>::infinity()) {}
};

// Squeezes bright colours into 0 .. 1 so that highlights keep their hue instead of clipping. Alpha stays.
Eigen::Vector3f tone_map(const Eigen::Vector3f& color);

// Linear light to the sRGB curve, within a fiftieth of an 8-bit step of it; the argument is clamped to 0 .. 1, NaN is
// 0. Square roots alone, so that every machine makes the same byte.
float srgb(float linear);

// Three bytes a pixel, as the screen shows the image over black.
std::vector<std::uint8_t> to_rgb8(const Image& image, int threads = 1);

}  // namespace strandbake
