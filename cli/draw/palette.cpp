#include "cli/draw/palette.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace strandbake {
namespace {

// Pixels of nearly one colour.
struct Bin {
  std::array<double, 3> mean{};
  double count = 0;
};

// A part of the bins, and along which component it spreads most.
struct Box {
  std::size_t first, end;
  int axis = 0;
  double error = 0;  // squared, of all its pixels to their mean
  std::array<double, 3> mean{};

  Box(std::size_t from, std::size_t to, const std::vector<Bin>& bins) : first(from), end(to) {
    double count = 0;
    std::array<double, 3> square{};
    for (std::size_t b = first; b < end; ++b) {
      count += bins[b].count;
      for (std::size_t c = 0; c < 3; ++c) {
        mean[c] += bins[b].count * bins[b].mean[c];
        square[c] += bins[b].count * bins[b].mean[c] * bins[b].mean[c];
      }
    }
    double widest = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      mean[c] /= std::max(count, 1.0);
      const double spread = square[c] - count * mean[c] * mean[c];
      error += spread;
      if (spread > widest) {
        widest = spread;
        axis = static_cast<int>(c);
      }
    }
    if (end - first < 2) error = 0;
  }
};

}  // namespace

Palette::Palette(std::span<const std::uint8_t> rgb) {
  constexpr int bits = 6;
  std::vector<Bin> all(std::size_t{1} << (3 * bits));
  for (std::size_t p = 0; p + 2 < rgb.size(); p += 3) {
    const auto part = [&](std::size_t c) { return static_cast<std::size_t>(rgb[p + c] >> (8 - bits)); };
    Bin& bin = all[(part(0) << (2 * bits)) + (part(1) << bits) + part(2)];
    ++bin.count;
    for (std::size_t c = 0; c < 3; ++c) bin.mean[c] += rgb[p + c];
  }
  std::vector<Bin> bins;
  for (Bin& bin : all) {
    if (bin.count == 0) continue;
    for (double& mean : bin.mean) mean /= bin.count;
    bins.push_back(bin);
  }
  all = {};
  std::vector<Box> boxes = {Box(0, bins.size(), bins)};
  while (boxes.size() < size) {
    const auto worst =
        std::max_element(boxes.begin(), boxes.end(), [](const Box& a, const Box& b) { return a.error < b.error; });
    if (!(worst->error > 0)) break;
    const Box box = *worst;
    const auto axis = static_cast<std::size_t>(box.axis);
    const auto begin = bins.begin();
    const auto middle = std::stable_partition(begin + static_cast<std::ptrdiff_t>(box.first),
                                              begin + static_cast<std::ptrdiff_t>(box.end),
                                              [&](const Bin& bin) { return bin.mean[axis] < box.mean[axis]; });
    const auto cut = static_cast<std::size_t>(middle - begin);
    if (cut == box.first || cut == box.end) {  // what is left is rounding
      worst->error = 0;
      continue;
    }
    *worst = Box(box.first, cut, bins);
    boxes.emplace_back(cut, box.end, bins);
  }
  const auto to_byte = [](double v) { return static_cast<std::uint8_t>(std::clamp(std::lround(v), 0L, 255L)); };
  const auto take = [&](std::size_t k, const std::array<double, 3>& mean) {
    colors_[k] = {to_byte(mean[0]), to_byte(mean[1]), to_byte(mean[2])};
  };
  for (std::size_t k = 0; k < boxes.size(); ++k) take(k, boxes[k].mean);
  for (int round = 0; round < 3; ++round) {
    std::array<Bin, size> sums{};
    for (const Bin& bin : bins) {
      Bin& sum = sums[nearest(static_cast<float>(bin.mean[0]), static_cast<float>(bin.mean[1]),
                              static_cast<float>(bin.mean[2]))];
      sum.count += bin.count;
      for (std::size_t c = 0; c < 3; ++c) sum.mean[c] += bin.count * bin.mean[c];
    }
    for (std::size_t k = 0; k < size; ++k) {
      if (sums[k].count == 0) continue;
      for (double& mean : sums[k].mean) mean /= sums[k].count;
      take(k, sums[k].mean);
    }
  }
}

std::uint8_t Palette::nearest(float r, float g, float b) const {
  float least = std::numeric_limits<float>::infinity();
  std::size_t best = 0;
  for (std::size_t k = 0; k < size; ++k) {
    const float dr = r - static_cast<float>(colors_[k][0]), dg = g - static_cast<float>(colors_[k][1]),
                db = b - static_cast<float>(colors_[k][2]);
    const float distance = 2 * dr * dr + 4 * dg * dg + db * db;  // as eyes weigh them
    if (distance < least) {
      least = distance;
      best = k;
    }
  }
  return static_cast<std::uint8_t>(best);
}

// Each colour of the mix makes up for the error of those before it.
Palette::Mix Palette::mix(const Rgb8& color) const {
  constexpr float share = 0.75f;  // of the error; all of it is noise where colours are far apart
  Mix mixed{};
  std::array<float, 3> error{};
  for (std::uint8_t& index : mixed) {
    std::array<float, 3> goal{};
    for (std::size_t c = 0; c < 3; ++c) goal[c] = static_cast<float>(color[c]) + share * error[c];
    index = nearest(goal[0], goal[1], goal[2]);
    for (std::size_t c = 0; c < 3; ++c) {
      error[c] += static_cast<float>(color[c]) - static_cast<float>(colors_[index][c]);
    }
  }
  const auto brightness = [&](std::uint8_t index) {
    return 2 * colors_[index][0] + 4 * colors_[index][1] + colors_[index][2];
  };
  std::sort(mixed.begin(), mixed.end(), [&](std::uint8_t a, std::uint8_t b) {
    return brightness(a) < brightness(b) || (brightness(a) == brightness(b) && a < b);
  });
  return mixed;
}

std::uint8_t Palette::index(const Rgb8& color, int x, int y) {
  constexpr std::array<std::uint8_t, side* side> order = {0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5};
  constexpr int bits = 7;
  if (known_.empty()) known_.assign(std::size_t{1} << (3 * bits), 0);
  std::size_t place = 0;
  for (const std::uint8_t part : color) place = (place << bits) + (part >> (8 - bits));
  std::uint32_t& known = known_[place];
  if (known == 0) {
    mixes_.push_back(mix(color));
    known = static_cast<std::uint32_t>(mixes_.size());
  }
  return mixes_[known - 1][order[static_cast<std::size_t>(y % side * side + x % side)]];
}

}  // namespace strandbake
