// What must not change the result: the method where all of them agree, rest, the place of the scene in the world,
// threads, lanes, and the other strands of the groom.
#include <atomic>
#include <catch2/catch.hpp>
#include <new>
#include <span>
#include <stdexcept>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

// The scene as seen from elsewhere: everything moved by `move`, and stretched by `scale`.
Shot moved_scene(const Shot& shot, const Eigen::Affine3d& move, double scale) {
  Shot moved = shot;
  for (Vector3d& p : moved.groom.position) p = move * p;
  moved.gravity = move.linear() * shot.gravity;
  moved.wind.velocity = move.linear() * shot.wind.velocity;
  moved.head = [head = shot.head, move](double time) {
    const Eigen::Affine3d to = move * Eigen::Affine3d(head(time).matrix()) * move.inverse();
    return pose(to.linear(), to.translation());
  };
  if (shot.spheres) {
    moved.spheres = [spheres = shot.spheres, move, scale](double time) {
      std::vector<Sphere> all = spheres(time);
      for (Sphere& sphere : all) sphere = {move * sphere.center, scale * sphere.radius};
      return all;
    };
  }
  return moved;
}

}  // namespace

TEST_CASE("hair at rest under no force does not move by a single bit") {
  Shot shot;
  shot.groom = awkward_groom(
      GENERATE(Vector3d(0, 0, 0), Vector3d(1e-7, -1e-7, 0), Vector3d(0.1, 1.7, -0.2), Vector3d(3000, -70, 1e5)));
  shot.gravity = {0, 0, 0};
  shot.frames = 50;
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  SECTION("default parameters") {}
  SECTION("many iterations, stiff") {
    shot.region.local.iterations = 7;
    shot.region.local.stiffness = 0.97;
    shot.region.lengths = LengthParams::iterated(9);
    shot.region.damping = 0;
    shot.substeps = 3;
  }
  SECTION("no damping, the global shape on everything") {
    shot.region.damping = 0;
    shot.region.global = {0.35, 1, 0.4};
    shot.substeps = 2;
  }
  SECTION("no damping, no global shape") {
    shot.region.damping = 0;
    shot.region.global.stiffness = 0;
    shot.substeps_at = [](int frame) { return 1 + frame % 4; };
  }
  SECTION("rigid") {
    shot.region.local.stiffness = 1;
    shot.region.global.stiffness = 1;
  }
  Eigen::AlignedBox3d box;
  for (const Vector3d& p : shot.groom.position) box.extend(p);
  const double size = 2 * box.diagonal().norm();
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    for (const int lanes : available_lanes()) {
      CAPTURE(shot.region.local.method, lanes, precision == Precision::Float);
      const std::vector<Points> taken = run(shot, {precision, 1, lanes});
      for (std::size_t v = 0; v < taken[0].size(); ++v) {
        // Rounded once where the solver keeps it, as far from the groom's centre as it is, and once in the world.
        const double kept = (precision == Precision::Double ? 0x1p-53 : 0x1p-24) * size;
        REQUIRE((taken[0][v] - shot.groom.position[v]).norm() <= kept + 0x1p-52 * shot.groom.position[v].norm());
      }
      for (const Points& frame : taken) REQUIRE(same_bits(frame, taken[0]));
    }
  }
}

// The head is turned, so the goals of the methods are rounded differently. What rounding does must stay what it
// is.
TEST_CASE("hair at rest on a turned head stays where it is to rounding") {
  Shot shot;
  shot.groom = mixed_groom(23, 30, 40);
  shot.gravity = {0, 0, 0};
  Random random(24);
  const Eigen::Isometry3d turned = pose(random.rotation(), {0.3, 1.5, -0.2});
  shot.head = [turned](double) { return turned; };
  shot.frames = 100;
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  const std::vector<Points> in_floats = run(shot, {}), in_doubles = run(shot, in_double());
  double floats = 0, doubles = 0;
  for (const Points& frame : in_floats) floats = std::max(floats, largest_distance(frame, in_floats[0]));
  for (const Points& frame : in_doubles) doubles = std::max(doubles, largest_distance(frame, in_doubles[0]));
  INFO("method " << shot.region.local.method << ": " << floats << " and " << doubles);
  CHECK(floats < 1e-4);
  CHECK(doubles < 4e-4 * 0x1p-29);
}

TEST_CASE("without local stiffness the method does not matter") {
  Shot shot = busy_shot();
  std::vector<std::vector<Points>> results;
  for (const int method : {1, 2, 3, 4}) {
    shot.regions_at = [method](int) {
      std::vector<RegionParams> regions(4);
      for (RegionParams& region : regions) region.local = {0, 3, method};
      return regions;
    };
    results.push_back(run(shot, {}));
  }
  for (std::size_t frame = 0; frame < results[0].size(); ++frame) {
    CHECK(same_bits(results[1][frame], results[0][frame]));
    CHECK(same_bits(results[2][frame], results[0][frame]));
    CHECK(same_bits(results[3][frame], results[0][frame]));
  }
}

// One free segment: its frame is that of the pinned root in every method, its batch the only one. Methods 1, 2 and 4
// then do the same operations; method 3 turns the rest edge in the world, not through the root's frame, and differs by
// rounding. With a reaction the others know that only one vertex moves, and are stiffer.
TEST_CASE("on a strand with one free segment the methods agree") {
  Shot shot;
  shot.region.local.reaction = GENERATE(false, true);
  Random random(25);
  for (int s = 0; s < 20; ++s) add_strand(shot.groom, rambling(random, 3, random.in_cube(0.1)));
  shot.head = dance;
  shot.substeps = 3;
  shot.frames = 30;
  std::vector<std::vector<Points>> results;
  for (const int method : {1, 2, 3, 4}) {
    shot.region.local.method = method;
    results.push_back(run(shot, in_double()));
  }
  CHECK(largest_distance(results[0].back(), results[0].front()) > 0.01);
  for (std::size_t frame = 0; frame < results[0].size(); ++frame) {
    CHECK(same_bits(results[1][frame], results[0][frame]));
    if (!shot.region.local.reaction) CHECK(largest_distance(results[2][frame], results[0][frame]) < 1e-13);
    CHECK(same_bits(results[3][frame], results[0][frame]));
  }
}

// Straight hair on a head that only travels and without forces that bend it: every frame is the root's.
TEST_CASE("on hair that moves without bending the methods agree") {
  Shot shot;
  for (const std::size_t vertices : {4u, 9u, 30u}) add_strand(shot.groom, straight(vertices, 0.2, {0.1, 0, 0}));
  shot.gravity = {0, -9.81, 0};  // along the hair
  shot.head = [](double time) { return pose(Eigen::Matrix3d::Identity(), {0, 0.1 * std::sin(9 * time), 0}); };
  shot.frames = 30;
  std::vector<std::vector<Points>> results;
  for (const int method : {1, 2, 3, 4}) {
    shot.region.local.method = method;
    results.push_back(run(shot, in_double()));
  }
  // Method 1 sweeps from root to tip, the others in batches: the stretch differs, the line does not.
  for (const auto& result : results) {
    for (const Vector3d& p : result.back()) CHECK(std::hypot(p.x() - 0.1, p.z()) < 1e-12);
  }
  for (std::size_t frame = 0; frame < results[1].size(); ++frame) {
    CHECK(largest_distance(results[1][frame], results[2][frame]) < 1e-12);
    CHECK(largest_distance(results[1][frame], results[3][frame]) < 1e-12);
  }
}

TEST_CASE("moving the whole scene moves the result") {
  Shot shot;
  shot.groom = mixed_groom(26, 30, 50);
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  shot.region.damping = 0.2;
  shot.wind.velocity = {2, 0.3, 1};
  shot.head = dance;
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.05, 0), 0.08}}; };
  shot.substeps = 2;
  shot.frames = 10;
  Random random(27);
  Eigen::Affine3d move = Eigen::Affine3d::Identity();
  double scale = 1;
  SECTION("elsewhere") {
    move.translation() = Vector3d(0.7, -2, 0.4);
  }
  SECTION("turned") {
    move.linear() = random.rotation();
  }
  SECTION("in a mirror") {
    move.linear() = (Eigen::Matrix3d::Identity() - 2 * Vector3d(0.6, 0, 0.8) * Vector3d(0.6, 0, 0.8).transpose());
  }
  SECTION("larger, with all that has metres in it") {
    scale = 3.7;
    move.linear() *= scale;
  }
  const Shot elsewhere = moved_scene(shot, move, scale);
  const auto here = run(shot, in_double()), there = run(elsewhere, in_double());
  CHECK(largest_distance(here.back(), here.front()) > 0.05);
  // A rounding of coordinates of 2 m is 2e-16 m, and ten frames let it grow; paper_test.cpp measures by how much.
  for (std::size_t frame = 0; frame < here.size(); ++frame) {
    Points expected = here[frame];
    for (Vector3d& p : expected) p = move * p;
    CAPTURE(frame, shot.region.local.method);
    CHECK(largest_distance(there[frame], expected) < 1e-10);
  }
}

TEST_CASE("threads and lanes have no influence on a single bit") {
  Shot shot = busy_shot();
  shot.frames = 5;
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const std::vector<Points> expected = run(shot, {precision, 1, available_lanes().front()});
    CHECK(largest_distance(expected.back(), expected.front()) > 0.02);
    for (const int lanes : available_lanes()) {
      for (const int threads : {1, 2, 3, 7}) {
        CAPTURE(lanes, threads);
        const std::vector<Points> taken = run(shot, {precision, threads, lanes});
        for (std::size_t frame = 0; frame < taken.size(); ++frame) REQUIRE(same_bits(taken[frame], expected[frame]));
      }
    }
  }
}

TEST_CASE("every width is the same on grooms that fill its blocks to any degree") {
  Shot shot;
  shot.head = dance;
  shot.frames = 4;
  for (const std::size_t strands : {1u, 3u, 4u, 5u, 8u, 9u, 15u, 16u, 17u, 33u}) {
    shot.groom = mixed_groom(static_cast<std::uint32_t>(100 + strands), strands, 30);
    for (const Precision precision : {Precision::Float, Precision::Double}) {
      const Points expected = run(shot, {precision, 1, available_lanes().front()}).back();
      for (const int lanes : available_lanes()) CHECK(same_bits(run(shot, {precision, 1, lanes}).back(), expected));
    }
  }
}

// A half turn makes minus zeros of zeros, and a transform can hold them itself. Whether a strand shares its block with
// shorter ones must not show even there.
TEST_CASE("minus zeros in the head transform are the same in every width") {
  Shot shot;
  add_strand(shot.groom, straight(9, 0.1, {0, -0.1, -0.2}));
  add_strand(shot.groom, straight(9, 0.1, {0, -0.2, -0.2}));
  for (int s = 0; s < 5; ++s) add_strand(shot.groom, straight(5, 0.1, {0, -0.1, -0.1}));
  for (int s = 0; s < 8; ++s) add_strand(shot.groom, straight(9, 0.1, {0, -0.1, -0.1}));
  Eigen::Matrix3d half_turn = Eigen::Vector3d(-1, 1, -1).asDiagonal();
  half_turn(0, 1) = half_turn(0, 2) = 0.0;
  const Eigen::Isometry3d head = pose(half_turn, {-0.0, -0.0, -0.0});
  shot.head = [head](double) { return head; };
  shot.gravity = {1, -9.81, 2};
  shot.region.lengths = LengthParams::iterated(0);
  shot.frames = 3;
  const std::vector<Points> expected = run(shot, {Precision::Double, 1, available_lanes().front()});
  for (const Points& frame : expected) {
    for (const Vector3d& p : frame) REQUIRE_FALSE((p.array() == 0 && p.array().cwiseInverse() < 0).any());
  }
  for (const int lanes : available_lanes()) {
    const std::vector<Points> taken = run(shot, {Precision::Double, 1, lanes});
    for (std::size_t frame = 0; frame < taken.size(); ++frame) CHECK(same_bits(taken[frame], expected[frame]));
  }
}

// Wind is left out: a strand's blend of gusts belongs to its number.
TEST_CASE("a strand does not notice the other strands of the groom") {
  Shot shot = busy_shot();
  shot.wind = {};
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const std::vector<Points> together = run(shot, {.precision = precision});
  const std::size_t strands = shot.groom.strand_count();
  SECTION("in reversed order") {
    Shot reversed = shot;
    reversed.groom = {};
    for (std::size_t s = strands; s-- > 0;) {
      add_strand(reversed.groom, points_of(shot.groom, s));
      reversed.groom.region.push_back(shot.groom.region[s]);
      for (std::size_t i = 0; i < shot.groom.vertex_count(s); ++i) {
        if (shot.groom.pinned[shot.groom.offset[s] + i] != 0) pin(reversed.groom, strands - 1 - s, i);
      }
    }
    const std::vector<Points> taken = run(reversed, {.precision = precision});
    for (std::size_t frame = 0; frame < taken.size(); ++frame) {
      for (std::size_t s = 0; s < strands; ++s) {
        for (std::size_t i = 0; i < shot.groom.vertex_count(s); ++i) {
          REQUIRE(taken[frame][reversed.groom.offset[strands - 1 - s] + i] ==
                  together[frame][shot.groom.offset[s] + i]);
        }
      }
    }
  }
  SECTION("alone, but for two stubs that leave the groom its bounds") {
    Eigen::AlignedBox3d box;
    for (const Vector3d& p : shot.groom.position) box.extend(p);
    for (std::size_t s = 0; s < strands; ++s) {
      Shot alone = shot;
      alone.groom = groom_of({points_of(shot.groom, s), {box.min(), box.min()}, {box.max(), box.max()}});
      alone.groom.region.assign(3, shot.groom.region[s]);
      for (std::size_t i = 0; i < shot.groom.vertex_count(s); ++i) {
        if (shot.groom.pinned[shot.groom.offset[s] + i] != 0) pin(alone.groom, 0, i);
      }
      const Points taken = run(alone, {.precision = precision}).back();
      for (std::size_t i = 0; i < shot.groom.vertex_count(s); ++i) {
        REQUIRE(taken[i] == together.back()[shot.groom.offset[s] + i]);
      }
    }
  }
}

TEST_CASE("positions read as floats are the double ones, rounded") {
  const Shot shot = busy_shot();
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {.precision = precision});
    for (int frame = 1; frame <= 3; ++frame) solver->advance(frame_input(shot, frame));
    Points doubles(shot.groom.vertex_count());
    std::vector<Eigen::Vector3f> floats(shot.groom.vertex_count());
    solver->read(doubles);
    solver->read(floats);
    for (std::size_t v = 0; v < floats.size(); ++v) {
      if (precision == Precision::Double) REQUIRE(floats[v] == doubles[v].cast<float>());
      REQUIRE((floats[v].cast<double>() - doubles[v]).norm() <= 2e-7 * doubles[v].norm());
    }
  }
}

TEST_CASE("the positions that advance gives are those that read gives") {
  const Shot shot = busy_shot();
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const int threads = GENERATE(1, 3);
  for (const int lanes : available_lanes()) {
    const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {precision, threads, lanes});
    std::vector<Eigen::Vector3f> given(shot.groom.vertex_count()), read(shot.groom.vertex_count());
    for (int frame = 1; frame <= 3; ++frame) {
      solver->advance(frame_input(shot, frame), given, {});
      solver->read(read);
      REQUIRE(given == read);
    }
    CHECK_THROWS_AS(solver->advance(frame_input(shot, 4), std::span(given).first(1), {}), std::invalid_argument);
  }
}

TEST_CASE("other work for the threads is done before and after theirs, and changes nothing") {
  const Shot shot = busy_shot();
  const auto alone = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {});
  const auto accompanied = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {.threads = 3});
  std::atomic<int> before = 0, after = 0;
  alone->advance(frame_input(shot, 1));
  accompanied->advance(frame_input(shot, 1), {}, [&](bool hair_is_left) { ++(hair_is_left ? before : after); });
  CHECK(before == 3);
  CHECK(after == 3);
  // What it throws comes out when the frame is done.
  const bool fails_before = GENERATE(true, false);
  alone->advance(frame_input(shot, 2));
  CHECK_THROWS_AS(accompanied->advance(frame_input(shot, 2), {},
                                       [&](bool hair_is_left) {
                                         if (hair_is_left == fails_before) throw std::bad_alloc();
                                       }),
                  std::bad_alloc);
  Points expected(shot.groom.vertex_count()), found(shot.groom.vertex_count());
  for (int frame = 3; frame <= 4; ++frame) {
    alone->read(expected);
    accompanied->read(found);
    CHECK(same_bits(expected, found));
    alone->advance(frame_input(shot, frame));
    accompanied->advance(frame_input(shot, frame));
  }
}
