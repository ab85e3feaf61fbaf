#include "sim/measure.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <limits>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

TEST_CASE("rest lengths stand at the vertex where the segment ends") {
  const Groom groom = groom_of({{{0, 0, 0}, {3, 4, 0}, {3, 4, 2}}, {{9, 9, 9}, {9, 9, 9}, {9, 8, 9}}});
  CHECK(rest_lengths(groom) == std::vector<float>{0, 5, 2, 0, 0, 1});
  CHECK(rest_lengths(Groom{}).empty());
}

TEST_CASE("the largest stretch is found among longer and shorter segments") {
  const std::vector<float> rest = {0, 1, 2, 0, 0, 4};
  std::vector<Eigen::Vector3f> p = {{0, 0, 0}, {1, 0, 0}, {1, 2, 0}, {7, 7, 7}, {7, 7, 9}, {7, 7, 13}};
  // As a whole, and in two parts that meet within a strand.
  const std::size_t cut = GENERATE(0, 2, 5);
  const auto measured = [&] {
    return std::max(largest_stretch(p, rest, {0, cut}), largest_stretch(p, rest, {cut, p.size()}));
  };
  // Between strands (vertex 3) and where the rest length is 0 (vertex 4) nothing is measured.
  CHECK(measured() == 0);
  p[1] = {1.25f, 0, 0};
  p[2] = {1.25f, 2, 0};
  CHECK(measured() == 0.25f);
  p[5] = {7, 7, 10};
  CHECK(measured() == 0.75f);
  CHECK(largest_stretch(p, rest, {3, 5}) == 0);
  CHECK(largest_stretch({}, {}, {0, 0}) == 0);
}

TEST_CASE("the deepest penetration counts free vertices only") {
  const std::vector<Eigen::Vector3f> p = {{0, 0, 0}, {0, 1, 0}, {0, 1.5f, 0}, {0, 3, 0}};
  const std::vector<std::uint8_t> pinned = {1, 1, 0, 0};
  const std::size_t cut = GENERATE(0, 3);
  const auto measured = [&](std::span<const Sphere> spheres) {
    return std::max(deepest_penetration(p, pinned, spheres, {0, cut}),
                    deepest_penetration(p, pinned, spheres, {cut, p.size()}));
  };
  const std::vector<Sphere> around_the_root = {{{0, 0, 0}, 2}};
  CHECK(measured(around_the_root) == 0.5f);
  const std::vector<Sphere> two = {{{0, 0, 0}, 2}, {{0, 4, 0}, 2.25}};
  CHECK(measured(two) == 1.25f);
  const std::vector<Sphere> far_away = {{{10, 0, 0}, 2}};
  CHECK(measured(far_away) == 0);
  CHECK(measured({}) == 0);
  CHECK(deepest_penetration(p, pinned, two, {0, 2}) == 0);
}

TEST_CASE("the first two vertices of a strand are pinned, and those the groom names") {
  Groom groom = groom_of({straight(4, 1), straight(2, 1), straight(3, 1)});
  CHECK(pinned_vertices(groom) == std::vector<std::uint8_t>{1, 1, 0, 0, 1, 1, 1, 1, 0});
  pin(groom, 0, 3);
  CHECK(pinned_vertices(groom) == std::vector<std::uint8_t>{1, 1, 0, 1, 1, 1, 1, 1, 0});
  CHECK(pinned_vertices(groom_of({{{0, 0, 0}}})) == std::vector<std::uint8_t>{1});
}
