#include "sim/measure.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sim/lanes.h"
#include "sim/passes/collide.h"
#include "sim/passes/strand_math.h"

namespace strandbake {
namespace {

constexpr float kShortest = 1e-5f;  // [m], see largest_stretch()

// Four vertices in a row.
using Four = Lanes<float, 4>;
using Points = Vec3<Four>;

Four numbers_at(const float* numbers) {
  typedef float Loaded __attribute__((vector_size(16), aligned(4), may_alias));
  return Four(Four::Vector(*reinterpret_cast<const Loaded*>(numbers)));
}

Points points_at(const Eigen::Vector3f* points) {
  const Four::Vector a = numbers_at(points->data()).v;                // x0 y0 z0 x1
  const Four::Vector b = numbers_at(points->data() + 4).v;            // y1 z1 x2 y2
  const Four::Vector c = numbers_at(points->data() + 8).v;            // z2 x3 y3 z3
  const Four::Vector xy = __builtin_shufflevector(b, c, 2, 5, 3, 6);  // x2 x3 y2 y3
  const Four::Vector yz = __builtin_shufflevector(a, b, 1, 4, 2, 5);  // y0 y1 z0 z1
  return {Four(__builtin_shufflevector(a, xy, 0, 3, 4, 5)), Four(__builtin_shufflevector(yz, xy, 0, 1, 6, 7)),
          Four(__builtin_shufflevector(yz, c, 2, 3, 4, 7))};
}

Vec3<float> point_at(const Eigen::Vector3f& p) {
  return {p.x(), p.y(), p.z()};
}

Four smaller(Four a, Four b) {
  return select(a < b, a, b);
}
Four larger(Four a, Four b) {
  return select(a > b, a, b);
}

}  // namespace

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
  // Of (length / rest length)^2, so that a root is drawn twice in all and not once a segment.
  float least = 1, most = 1;
  Four least_four(1.0f), most_four(1.0f);
  std::size_t v = std::max<std::size_t>(range.first, 1);
  for (; v + 4 <= range.last; v += 4) {
    const Points edge = points_at(&position[v]) - points_at(&position[v - 1]);
    const Four rest = numbers_at(&rest_length[v]);
    const Four ratio2 = select(rest < Four(kShortest), Four(1.0f), inner(edge, edge) / (rest * rest));
    least_four = select(ratio2 < least_four, ratio2, least_four);
    most_four = select(ratio2 > most_four, ratio2, most_four);
  }
  for (; v < range.last; ++v) {
    const float rest = rest_length[v];
    if (rest < kShortest) continue;
    const Vec3<float> edge = point_at(position[v]) - point_at(position[v - 1]);
    const float ratio2 = inner(edge, edge) / (rest * rest);
    least = std::min(least, ratio2);
    most = std::max(most, ratio2);
  }
  for (int lane = 0; lane < 4; ++lane) {
    least = std::min(least, least_four.v[lane]);
    most = std::max(most, most_four.v[lane]);
  }
  return std::max(1 - std::sqrt(least), std::sqrt(most) - 1);
}

float deepest_penetration(std::span<const Eigen::Vector3f> position, std::span<const std::uint8_t> pinned,
                          std::span<const Sphere> spheres, VertexRange range) {
  constexpr std::size_t kAtOnce = 64;  // vertices that share a box
  constexpr float kFar = std::numeric_limits<float>::infinity();
  float deepest = 0;
  for (std::size_t first = range.first; first < range.last && !spheres.empty(); first += kAtOnce) {
    const std::size_t last = std::min(first + kAtOnce, range.last);
    // The free vertices, four by four, filled up with others far away.
    Points points[kAtOnce / 4];
    Points low = {kFar, kFar, kFar}, high = {-kFar, -kFar, -kFar};
    std::size_t fours = 0;
    for (std::size_t v = first; v < last; v += 4, ++fours) {
      Points& p = points[fours];
      Four::Mask is_free{};
      if (v + 4 <= last) {
        p = points_at(&position[v]);
        is_free.v = Four::Mask::Masks{pinned[v], pinned[v + 1], pinned[v + 2], pinned[v + 3]} == 0;
      } else {
        p = {0.0f, 0.0f, 0.0f};
        for (int k = 0; v + static_cast<std::size_t>(k) < last; ++k) {
          const std::size_t at = v + static_cast<std::size_t>(k);
          p.x.v[k] = position[at].x();
          p.y.v[k] = position[at].y();
          p.z.v[k] = position[at].z();
          is_free.v[k] = pinned[at] ? 0 : -1;
        }
      }
      low = {smaller(low.x, select(is_free, p.x, kFar)), smaller(low.y, select(is_free, p.y, kFar)),
             smaller(low.z, select(is_free, p.z, kFar))};
      high = {larger(high.x, select(is_free, p.x, -kFar)), larger(high.y, select(is_free, p.y, -kFar)),
              larger(high.z, select(is_free, p.z, -kFar))};
      p.x = select(is_free, p.x, kFar);
    }
    for (const Sphere& sphere : spheres) {
      const Vec3<float> c = point_at(sphere.center.cast<float>());
      const Points center = {c.x, c.y, c.z};
      const auto radius = static_cast<float>(sphere.radius);
      if (!any(squared_distance_to_box(low, high, center) < Four(radius * radius))) continue;
      Four nearest(kFar);
      for (std::size_t k = 0; k < fours; ++k) nearest = smaller(squared_distance(points[k], center), nearest);
      for (int lane = 0; lane < 4; ++lane) deepest = std::max(deepest, radius - std::sqrt(nearest.v[lane]));
    }
  }
  return deepest;
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
