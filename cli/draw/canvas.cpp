#include "cli/draw/canvas.h"

#include <cmath>
#include <stdexcept>
#include <string>

namespace strandbake {

Image::Image(int w, int h, const Eigen::Vector4f& fill) : width(w), height(h) {
  if (w < 0 || h < 0) {
    throw std::invalid_argument("an image cannot measure " + std::to_string(w) + " x " + std::to_string(h) + " pixels");
  }
  pixel.assign(static_cast<std::size_t>(w) * static_cast<std::size_t>(h), fill);
}

Eigen::Vector3f tone_map(const Eigen::Vector3f& color) {
  // Straight up to the knee, then x -> 1 with the same slope at the knee, applied to the largest component so that the
  // hue stays; the part that was squeezed away pulls the colour toward white a little, as film does.
  constexpr float knee = 0.6f;
  const float peak = color.maxCoeff();
  if (!(peak > knee)) return color;
  const float over = (peak - knee) / (1 - knee);
  const float squeezed = knee + (1 - knee) * over / (1 + over);
  const Eigen::Vector3f hue = color * (squeezed / peak);
  const float bleach = 0.35f * over / (2 + over);
  return hue + bleach * (Eigen::Vector3f::Constant(squeezed) - hue);
}

float srgb(float linear) {
  if (!(linear > 0)) return 0;
  if (linear >= 1) return 1;
  if (linear < 0.0031308f) return 12.92f * linear;
  // A least-squares fit of the curve in x^(1/2), x^(1/4), x^(1/8).
  const float s1 = std::sqrt(linear), s2 = std::sqrt(s1), s3 = std::sqrt(s2);
  return 0.642367122f * s1 + 0.712108992f * s2 - 0.336869382f * s3 - 0.0175636790f * linear;
}

std::vector<std::uint8_t> to_rgb8(const Image& image, int threads) {
  std::vector<std::uint8_t> bytes(image.pixel.size() * 3);
#pragma omp parallel for schedule(static) num_threads(threads)
  for (std::size_t p = 0; p < image.pixel.size(); ++p) {
    for (std::size_t c = 0; c < 3; ++c) {
      bytes[3 * p + c] = static_cast<std::uint8_t>(255 * srgb(image.pixel[p][static_cast<Eigen::Index>(c)]) + 0.5f);
    }
  }
  return bytes;
}

}  // namespace strandbake
