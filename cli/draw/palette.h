// The 255 colours of a GIF, and the pattern of them that stands for any other colour.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace strandbake {

using Rgb8 = std::array<std::uint8_t, 3>;

class Palette {
 public:
  static constexpr std::size_t size = 255;  // one of 256 is left to say "as before"

  // Chosen for these pixels, three bytes each: the colour space is cut where that lessens the squared error most, then
  // each colour moves to the mean of what it stands for. The same pixels make the same palette.
  explicit Palette(std::span<const std::uint8_t> rgb);

  const std::array<Rgb8, size>& colors() const { return colors_; }
  // The colour for a pixel. Around it, others are chosen so that their mean is what was asked for (ordered dithering
  // after Knoll); the pattern hangs on the place alone, so what stands still in a clip stays as it is.
  std::uint8_t index(const Rgb8& color, int x, int y);

 private:
  static constexpr int side = 4;  // of the pattern [pixels]
  using Mix = std::array<std::uint8_t, side * side>;

  std::uint8_t nearest(float r, float g, float b) const;
  Mix mix(const Rgb8& color) const;

  std::array<Rgb8, size> colors_{};
  std::vector<std::uint32_t> known_;  // for each colour of seven bits a component: 1 + its place in mixes_, or 0
  std::vector<Mix> mixes_;
};

}  // namespace strandbake
