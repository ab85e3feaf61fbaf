#include "sim/measure.h"

#include <algorithm>
#include <cmath>

#include "sim/lanes.h"
#include "sim/passes/collide.h"
#include "sim/passes/length_ratio.h"
#include "sim/passes/strand_math.h"

namespace strandbake {
namespace {

template <class Real>
Real smaller(Real a, Real b) {
  return select(a < b, a, b);
}
template <class Real>
Real larger(Real a, Real b) {
  return select(a > b, a, b);
}

// Least and most of (length / rest length)^2.
template <class Real>
struct Lengths {
  Real least = 1, most = 1;

  void add(Real ratio2) {
    least = smaller(ratio2, least);
    most = larger(ratio2, most);
  }
  float largest_error() const {
    float largest = 0;
    for (int lane = 0; lane < Real::width; ++lane) {
      largest = std::max(largest, static_cast<float>(1 - std::sqrt(least.v[lane])));
      largest = std::max(largest, static_cast<float>(std::sqrt(most.v[lane]) - 1));
    }
    return largest;
  }
};

// As many strands of a block as a vector holds on every machine.
template <class Scalar>
struct Strands {
  using Real = Lanes<Scalar, 16 / sizeof(Scalar)>;
  using Vec = Vec3<Real>;

  const Block<Scalar>& block;
  const Scalar* now;
  std::size_t width;
  std::size_t lane;

  Real number(const Scalar* array, int i) const { return row(array, static_cast<std::size_t>(i)); }
  Vec position(int i) const {
    const std::size_t first = 3 * static_cast<std::size_t>(i);
    return {row(now, first), row(now, first + 1), row(now, first + 2)};
  }

  void measure_lengths(Figures& found) const {
    Lengths<Real> all, held;
    Vec before = position(0);
    for (int i = 1; i < block.vertices; ++i) {
      const Vec here = position(i);
      const Real ratio2 = squared_length_ratio(here - before, number(block.length, i));
      all.add(ratio2);
      if (block.masked && i >= 2) held.add(select(number(block.swept, i) > Real(0), Real(1), ratio2));
      before = here;
    }
    found.largest_stretch = std::max(found.largest_stretch, all.largest_error());
    found.residual = std::max(found.residual, held.largest_error());
  }

  void measure_depth(const Scalar* spheres, int sphere_count, Figures& found) const {
    if (sphere_count == 0 || block.vertices < 3) return;
    Vec low = position(2), high = low;
    for (int i = 3; i < block.vertices; ++i) {
      const Vec here = position(i);
      low = {smaller(here.x, low.x), smaller(here.y, low.y), smaller(here.z, low.z)};
      high = {larger(here.x, high.x), larger(here.y, high.y), larger(here.z, high.z)};
    }
    for (int s = 0; s < sphere_count; ++s, spheres += 4) {
      const Vec center = {Real(spheres[0]), Real(spheres[1]), Real(spheres[2])};
      const Real radius2(spheres[3] * spheres[3]);
      if (!any(squared_distance_to_box(low, high, center) < radius2)) continue;
      Real nearest = radius2;
      for (int i = 2; i < block.vertices; ++i) {
        Real distance2 = squared_distance(position(i), center);
        if (block.masked) distance2 = select(number(block.free, i) > Real(0), distance2, radius2);
        nearest = smaller(distance2, nearest);
      }
      for (int k = 0; k < Real::width; ++k) {
        const auto depth = static_cast<float>(spheres[3] - std::sqrt(nearest.v[k]));
        found.deepest_penetration = std::max(found.deepest_penetration, depth);
      }
    }
  }

 private:
  Real row(const Scalar* array, std::size_t row) const {
    return *reinterpret_cast<const Real*>(array + row * width + lane);
  }
};

}  // namespace

void Figures::include(const Figures& other) {
  largest_stretch = std::max(largest_stretch, other.largest_stretch);
  residual = std::max(residual, other.residual);
  deepest_penetration = std::max(deepest_penetration, other.deepest_penetration);
}

template <class Scalar>
Figures measure_block(const Block<Scalar>& block, const Scalar* now, int width, const Scalar* spheres,
                      int sphere_count) {
  Figures found;
  for (int lane = 0; lane < width; lane += Strands<Scalar>::Real::width) {
    const Strands<Scalar> strands = {block, now, static_cast<std::size_t>(width), static_cast<std::size_t>(lane)};
    strands.measure_lengths(found);
    strands.measure_depth(spheres, sphere_count, found);
  }
  return found;
}
template Figures measure_block(const Block<float>&, const float*, int, const float*, int);
template Figures measure_block(const Block<double>&, const double*, int, const double*, int);

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
