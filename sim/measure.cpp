#include "sim/measure.h"

#include <algorithm>
#include <cmath>

namespace strandbake {

std::vector<float> rest_lengths(const Groom& groom) {
  std::vector<float> length(groom.vertex_count(), 0.0f);
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    for (std::size_t v = groom.offset[strand] + 1; v < groom.offset[strand + 1]; ++v) {
      length[v] = static_cast<float>((groom.position[v] - groom.position[v - 1]).norm());
    }
  }
  return length;
}

float largest_stretch(std::span<const Eigen::Vector3f> position, std::span<const float> rest_length,
                      VertexRange range) {
  double largest = 0;
  for (std::size_t v = std::max<std::size_t>(range.first, 1); v < range.last; ++v) {
    if (rest_length[v] < 1e-5f) continue;
    const double length = (position[v].cast<double>() - position[v - 1].cast<double>()).norm();
    largest = std::max(largest, std::abs(length / rest_length[v] - 1));
  }
  return static_cast<float>(largest);
}

float deepest_penetration(std::span<const Eigen::Vector3f> position, std::span<const std::uint8_t> pinned,
                          std::span<const Sphere> spheres, VertexRange range) {
  double deepest = 0;
  for (std::size_t v = range.first; v < range.last; ++v) {
    if (pinned[v]) continue;
    for (const Sphere& sphere : spheres) {
      deepest = std::max(deepest, sphere.radius - (position[v].cast<double>() - sphere.center).norm());
    }
  }
  return static_cast<float>(deepest);
}

std::vector<std::uint8_t> pinned_vertices(const Groom& groom) {
  std::vector<std::uint8_t> pinned = groom.pinned;
  pinned.resize(groom.vertex_count(), 0);
  for (std::size_t strand = 0; strand < groom.strand_count(); ++strand) {
    for (std::size_t v = groom.offset[strand]; v < std::min(groom.offset[strand] + 2, groom.offset[strand + 1]); ++v)
      pinned[v] = 1;
  }
  return pinned;
}

}  // namespace strandbake
