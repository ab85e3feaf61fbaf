// A small groom and its frames for the tests of the cache. Every number can be computed again exactly, in Python too.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "formats/cache.h"

namespace strandbake {

// Strands of 2 to 14 vertices in three regions.
inline CacheHeader sample_header(std::uint64_t strands) {
  CacheHeader header;
  header.fps = 24;
  header.offset = {0};
  header.region_names = {"top", "tail", "Stirnzöpfchen"};
  std::uint32_t state = 12345;
  const auto next = [&state] {  // -0.5 .. 0.5
    state = state * 1664525U + 1013904223U;
    return static_cast<float>(state >> 8) * 0x1p-24F - 0.5F;
  };
  for (std::uint64_t strand = 0; strand < strands; ++strand) {
    header.offset.push_back(header.offset.back() + 2 + 7 * strand % 13);
    header.region.push_back(static_cast<std::uint32_t>(strand % 3));
    header.root_uv.emplace_back(next(), next());
  }
  for (std::uint64_t vertex = 0; vertex < header.offset.back(); ++vertex) {
    const float x = next();
    const float y = next();
    header.rest_position.emplace_back(x, y, next());
  }
  header.colliders = 2;
  header.program_version = "0.1.0";
  header.scene_text = "[bake]\nframes = \"1-5\"  # Haar für den Test\n";
  header.inputs = {{"groom/top.hair", std::string(64, 'a')}, {"head.glb", std::string(64, '7')}};
  header.parameters = {{"bake.substeps", "8"}, {"region.tail.damping", "0.1"}, {"wind.gust", ""}};
  return header;
}

// Frame n: each vertex at rest + n (1/4, 1/2, -1/8), velocity 24 (1/4, 1/2, -1/8) + rest, the head turned n * 90
// degrees about y and moved by n along x, collider c at (n, c, -n) with radius (c + 1) / 8.
struct SampleFrame {
  std::vector<Eigen::Vector3f> position;
  std::vector<Eigen::Vector3f> velocity;
  std::vector<Sphere> colliders;
  CacheFrame frame;  // refers to those above

  SampleFrame(const SampleFrame&) = delete;
  SampleFrame& operator=(const SampleFrame&) = delete;
  SampleFrame(const CacheHeader& header, const CacheOptions& options, int number) {
    const Eigen::Vector3f step(0.25F, 0.5F, -0.125F);
    for (const Eigen::Vector3f& rest : header.rest_position) {
      position.emplace_back(rest + static_cast<float>(number) * step);
      if (options.velocity) velocity.emplace_back(rest + 24 * step);
    }
    frame.number = number;
    frame.time = number / header.fps;
    frame.position = position;
    if (options.velocity) {
      frame.velocity = [this](std::size_t first, std::span<Eigen::Vector3f> out) {
        std::copy_n(velocity.begin() + static_cast<std::ptrdiff_t>(first), out.size(), out.begin());
      };
    }
    Eigen::Matrix3d quarter;
    quarter << 0, 0, 1, 0, 1, 0, -1, 0, 0;
    for (int turn = 0; turn < number % 4; ++turn) frame.head.rotate(quarter);
    frame.head.translation().x() = number;
    for (std::size_t c = 0; c < header.colliders; ++c) {
      const auto place = static_cast<double>(c);
      colliders.push_back({{static_cast<double>(number), place, -static_cast<double>(number)}, (place + 1) / 8});
    }
    frame.colliders = colliders;
    frame.stats = {static_cast<float>(number) * 0.5F, static_cast<float>(number) * 0.125F,
                   static_cast<float>(number) * 0.25F, 3 * number};
  }
};

}  // namespace strandbake
