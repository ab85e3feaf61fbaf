// The solver in double against the plain transcription of the paper (paper_reference.h).
//
// Both round differently, by a few units in the last place per operation, and hair amplifies what is different: bends
// are follower forces, so a shot without damping doubles a distance every few frames. Two yardsticks follow from it:
//   - one frame from rest: a distance of 1e-13 m, some hundred roundings of coordinates below 1 m;
//   - a shot: the reference is run once more from a start that is disturbed by 1e-12 m. What grows from rounding must
//   stay below
//     what grows from that, at every frame; a difference in the method would begin far above.
#include "tests/sim/paper_reference.h"

#include <catch2/catch.hpp>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

constexpr double kOneFrame = 1e-13;     // [m]
constexpr double kDisturbance = 1e-12;  // [m]

void check_one_frame(Shot shot) {
  shot.frames = 1;
  const std::vector<Points> ours = run(shot, in_double());
  paper::Reference reference(shot.groom, shot.head(0));
  CHECK(largest_distance(ours[0], reference.positions()) < 1e-15);
  reference.advance(frame_input(shot, 1));
  CHECK(largest_distance(ours[1], reference.positions()) < kOneFrame);
}

void check_shot(const Shot& shot) {
  const std::vector<Points> ours = run(shot, in_double());
  paper::Reference reference(shot.groom, shot.head(0)), disturbed(shot.groom, shot.head(0));
  Random random(99);
  for (paper::Strand& strand : disturbed.strands()) {
    for (std::size_t i = 0; i < strand.positions().size(); ++i) strand.disturb(i, kDisturbance * random.direction());
  }
  double moved = 0, allowed = kDisturbance;
  for (int frame = 1; frame <= shot.frames; ++frame) {
    const FrameInput input = frame_input(shot, frame);
    reference.advance(input);
    disturbed.advance(input);
    const Points expected = reference.positions();
    allowed = std::max(allowed, largest_distance(disturbed.positions(), expected));
    moved = std::max(moved, largest_distance(expected, ours[0]));
    INFO("frame " << frame << ", the disturbed reference is " << allowed << " m away");
    REQUIRE(allowed < 1e-4);  // else the comparison says nothing
    REQUIRE(largest_distance(ours[static_cast<std::size_t>(frame)], expected) < allowed);
  }
  CHECK(moved > 0.001);
}

Shot shot_with_method(int method) {
  Shot shot;
  shot.groom = mixed_groom(1, 41, 80);
  shot.region.local.method = method;
  shot.region.local.reaction = false;
  shot.region.lengths = LengthParams::iterated(2);
  shot.head = dance;
  shot.frames = 12;
  return shot;
}

}  // namespace

TEST_CASE("damping and gravity alone move hair as the paper's integration does") {
  Shot shot = shot_with_method(1);
  shot.region.local.iterations = 0;
  shot.region.global.stiffness = 0;
  shot.region.lengths = LengthParams::iterated(0);
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("each pass alone follows the paper") {
  const int method = GENERATE(1, 2, 3, 4);
  CAPTURE(method);
  Shot shot = shot_with_method(method);
  shot.region.local.iterations = 0;
  shot.region.global.stiffness = 0;
  shot.region.lengths = LengthParams::iterated(0);
  SECTION("local shape") {
    shot.region.local.iterations = GENERATE(1, 4);
    shot.region.local.reaction = GENERATE(false, true);
    check_one_frame(shot);
    check_shot(shot);
  }
  SECTION("global shape that fades") {
    shot.region.global.stiffness = 0.4;
    shot.region.global.range = 0.613;
    check_one_frame(shot);
    check_shot(shot);
  }
  SECTION("global shape with a hard end") {
    shot.region.global.stiffness = 0.4;
    shot.region.global.range = 0.613;
    shot.region.global.fade = 0;
    check_one_frame(shot);
    check_shot(shot);
  }
  SECTION("global shape on the whole strand, tip included") {
    shot.region.global.stiffness = 0.4;
    shot.region.global.range = 1;
    shot.region.global.fade = 0.25;
    check_one_frame(shot);
    check_shot(shot);
  }
  SECTION("edge lengths") {
    shot.region.lengths = LengthParams::iterated(5);
    check_one_frame(shot);
    check_shot(shot);
  }
}

TEST_CASE("the default parameters follow the paper for every method and number of substeps") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  shot.substeps = GENERATE(1, 3, 8);
  shot.fps = 24;
  CAPTURE(shot.region.local.method, shot.substeps);
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("extreme stiffness and damping follow the paper") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  shot.region.local.stiffness = GENERATE(0.0, 0.02, 1.0);
  shot.region.damping = GENERATE(0.0, 1.0);
  shot.region.local.reaction = shot.region.damping == 0;
  shot.frames = 5;
  CAPTURE(shot.region.local.method, shot.region.local.stiffness, shot.region.damping);
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("wind and gusts blow as written, on each strand with its own weights") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  shot.wind.velocity = {6, 1, -2};
  shot.wind.gust = 0.8;
  shot.wind.period = 0.11;
  shot.region.drag = 2.5;
  shot.substeps = 2;
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("moving spheres push hair as the paper says") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  // Two that overlap, so that their order counts, and one that comes from the side.
  shot.spheres = [](double time) {
    return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.02, 0), 0.09},
                               {dance(time) * Vector3d(0.03, -0.06, 0), 0.08},
                               {{0.3 - time, -0.1, 0.05}, 0.1}};
  };
  shot.substeps = 2;
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("regions keep their own parameters") {
  Shot shot = shot_with_method(1);
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s)
    shot.groom.region.push_back(static_cast<std::uint32_t>(s % 5));
  shot.regions_at = [](int) {
    std::vector<RegionParams> regions(5);
    for (RegionParams& region : regions) region.lengths = LengthParams::iterated(2);
    for (int r = 0; r < 3; ++r) regions[static_cast<std::size_t>(r)].local.method = r + 1;
    regions[1].damping = 0.02;
    regions[1].global = {0.6, 0.871, 0.3};
    regions[2].lengths = LengthParams::iterated(7);
    regions[2].drag = 0;
    regions[3].local.stiffness = 0;
    regions[3].global.stiffness = 0;
    regions[4].local.method = 4;
    return regions;
  };
  shot.wind.velocity = {2, 0, 1};
  shot.substeps = 2;
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("strands pinned at both ends and in the middle follow the paper") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  Random random(5);
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    const std::size_t vertices = shot.groom.vertex_count(s);
    if (s % 3 != 0) pin(shot.groom, s, vertices - 1);
    if (s % 3 != 1) pin(shot.groom, s, static_cast<std::size_t>(random.integer(0, static_cast<int>(vertices) - 1)));
  }
  shot.region.global.range = 0.8;
  shot.region.local.reaction = GENERATE(false, true);
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, -0.02, 0), 0.11}}; };
  shot.wind.velocity = {2, 0, 1};
  shot.substeps = 2;
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("parameters that change from frame to frame take effect in their frame") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  const int method = shot.region.local.method;
  shot.regions_at = [method](int frame) {
    RegionParams params;
    params.lengths = LengthParams::iterated(2);
    params.local.method = method;
    params.damping = 0.05 * (frame % 4);
    params.drag = frame % 3;
    params.local.stiffness = 0.1 + 0.05 * frame;
    params.global.stiffness = frame < 4 ? 0 : 0.7 / frame;
    return std::vector<RegionParams>{params};
  };
  shot.wind.velocity = {3, 0, 0};
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("a change of the number of substeps between frames keeps the velocity") {
  Shot shot = shot_with_method(GENERATE(1, 2, 3, 4));
  shot.substeps_at = [](int frame) { return std::vector<int>{1, 4, 3, 3, 8, 2}[static_cast<std::size_t>(frame) % 6]; };
  check_one_frame(shot);
  check_shot(shot);
}

TEST_CASE("everything at once follows the paper") {
  Shot shot = shot_with_method(1);
  Random random(6);
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    shot.groom.region.push_back(static_cast<std::uint32_t>(s / 3 % 4));
    if (s % 5 == 0) pin(shot.groom, s, shot.groom.vertex_count(s) - 1);
  }
  shot.regions_at = [](int frame) {
    std::vector<RegionParams> regions(4);
    for (int r = 0; r < 4; ++r) {
      RegionParams& region = regions[static_cast<std::size_t>(r)];
      region.local = {0.2 + 0.02 * frame, 2 + r, r + 1};
      region.global = {0.05 * frame, 0.2 + 0.2 * r, 0.3 * r};
      region.lengths = LengthParams::iterated(r);
      region.damping = 0.03 * (r + 1);
    }
    return regions;
  };
  shot.wind = {{4, 0, 1}, 0.5, 0.2};
  shot.spheres = [](double time) { return std::vector<Sphere>{{dance(time) * Vector3d(0, 0, 0), 0.1}}; };
  shot.substeps_at = [](int frame) { return 1 + frame % 3; };
  shot.fps = 24;
  check_one_frame(shot);
  check_shot(shot);
}
