// What the solver leaves out changes not a bit, and what it counts is what happened.
#include <catch2/catch.hpp>

#include "sim/plan.h"
#include "sim/solver.h"
#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

struct Ran {
  std::vector<Points> taken;
  WorkCount work;
};

Ran run_with(const Shot& shot, Precision precision, const Skip& skip, int lanes = 0) {
  Plan plan;
  for (std::size_t r = 0; r < regions_of(shot, 1).size(); ++r) {
    std::vector<RegionParams> over_time;
    for (int frame = 1; frame <= shot.frames; ++frame) over_time.push_back(regions_of(shot, frame)[r]);
    plan.regions.push_back(plan_region(over_time, is_windy(shot), skip.passes));
  }
  const auto solver =
      make_openmp_solver(shot.groom, plan, shot.head(0), {.precision = precision, .lanes = lanes, .skip = skip});
  Ran ran;
  for (int frame = 1; frame <= shot.frames; ++frame) {
    solver->advance(frame_input(shot, frame));
    ran.taken.emplace_back(shot.groom.vertex_count());
    solver->read(ran.taken.back());
  }
  ran.work = solver->work();
  return ran;
}

bool same(const Ran& a, const Ran& b) {
  for (std::size_t frame = 0; frame < a.taken.size(); ++frame) {
    if (!same_bits(a.taken[frame], b.taken[frame])) return false;
  }
  return a.taken.size() == b.taken.size();
}

void check_every_skip(const Shot& shot) {
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    const Ran reference = run_with(shot, precision, {});
    for (const int lanes : available_lanes()) CHECK(same(reference, run_with(shot, precision, {}, lanes)));
    Skip nothing;
    const std::vector<std::pair<const char*, bool Skip::*>> each = {{"passes", &Skip::passes},
                                                                    {"range", &Skip::range},
                                                                    {"colliders", &Skip::colliders},
                                                                    {"resting", &Skip::resting},
                                                                    {"regions", &Skip::regions}};
    for (const auto& [name, what] : each) {
      CAPTURE(name);
      Skip all_but_one;
      all_but_one.*what = false;
      CHECK(same(reference, run_with(shot, precision, all_but_one)));
      nothing.*what = false;
    }
    CHECK(same(reference, run_with(shot, precision, nothing)));
  }
}

// A head that dances from frame 4 to 8 and then stands.
Isometry3d dance_and_stand(double time) {
  return dance(std::clamp(time, 4.0 / 60, 8.0 / 60));
}

}  // namespace

TEST_CASE("skipping changes not a bit of a shot with everything on") {
  Shot shot;
  shot.groom = mixed_groom(7, 90, 23);
  for (std::size_t s = 0; s < shot.groom.strand_count(); ++s) {
    shot.groom.region.push_back(static_cast<std::uint32_t>(s % 6));
    if (s % 9 == 0 && shot.groom.vertex_count(s) > 4) pin(shot.groom, s, 3);
  }
  shot.head = dance_and_stand;
  shot.spheres = [](double time) {
    return std::vector<Sphere>{{{0, 0, 0}, 0.11}, {{0.15, -0.1 - 0.1 * std::min(time, 0.1), 0}, 0.08}, {{9, 9, 9}, 1}};
  };
  shot.wind.velocity = {1, 0, 2};
  shot.wind.gust = 0.5;
  shot.substeps = 3;
  shot.frames = 12;
  shot.regions_at = [](int frame) {
    std::vector<RegionParams> regions(6);
    regions[0].local.method = 1;
    regions[0].global.stiffness = frame < 6 ? 0.4 : 0;
    regions[1].local.method = 2;
    regions[1].drag = frame < 9 ? 1 : 0;
    regions[2].local.method = 3;
    regions[2].local.stiffness = frame < 5 ? 0 : 0.8;
    regions[3].simulate = false;
    regions[4].global.stiffness = 0;
    regions[4].drag = 0;
    regions[4].local.stiffness = 0;
    regions[5].local.method = 4;
    regions[5].local.stiffness = frame < 3 ? 0.6 : 0.2;
    return regions;
  };
  check_every_skip(shot);
}

TEST_CASE("hair at rest under a head that stands is left alone until something changes") {
  const int method = GENERATE(1, 2, 3, 4);
  CAPTURE(method);
  Shot shot;
  shot.groom = mixed_groom(3, 40, 12);
  shot.gravity = {0, 0, 0};
  shot.region.local.method = method;
  shot.substeps = 2;
  shot.frames = 10;
  SECTION("for ever") {
    const Ran ran = run_with(shot, Precision::Float, {});
    // The first substep finds the fixed point.
    const long long blocks = ran.work.substeps / 20;
    CHECK(ran.work.substeps_at_rest == 19 * blocks);
    CHECK(run_with(shot, Precision::Float, {.resting = false}).work.substeps_at_rest == 0);
  }
  SECTION("until the head moves") {
    shot.head = [](double time) { return dance(std::max(0.0, time - 5.5 / 60)); };
  }
  SECTION("until the wind rises") {
    shot.wind.velocity = {2, 0, 0};
    shot.regions_at = [=](int frame) {
      RegionParams region;
      region.local.method = method;
      region.drag = frame > 6 ? 1 : 0;
      return std::vector<RegionParams>{region};
    };
  }
  SECTION("until a sphere comes") {
    shot.spheres = [](double time) { return std::vector<Sphere>{{{0, time > 0.1 ? -0.1 : -5.0, 0}, 0.1}}; };
  }
  SECTION("until gravity is let in") {
    shot.gravity = {0, -9.81, 0};
    shot.frames = 4;
  }
  check_every_skip(shot);
}

TEST_CASE("hair that swings out comes to rest to the bit, and is then left alone") {
  // A pendulum of one segment with full damping falls onto its sphere and stays there.
  Shot shot;
  shot.groom = groom_of({straight(3, 0.1, {0, 0, 0}, {1, 0, 0})});
  shot.region.damping = 1;
  shot.region.local.stiffness = 0;
  shot.region.global.stiffness = 1;
  shot.region.global.range = 1;
  shot.region.global.fade = 0;
  shot.frames = 40;
  shot.spheres = [](double) { return std::vector<Sphere>{{{0.1, -0.05, 0}, 0.02}}; };
  const Ran ran = run_with(shot, Precision::Float, {});
  CHECK(ran.work.substeps_at_rest > 20);
  CHECK(same(ran, run_with(shot, Precision::Float, {.resting = false})));
}

TEST_CASE("spheres out of reach are counted, and a sphere that only a push brings into reach is not") {
  Shot shot;
  shot.region.lengths = LengthParams::iterated(2);
  shot.groom = groom_of({straight(6, 0.1)});
  shot.gravity = {0, 0, 0};
  // The first sphere pushes vertices into the second, which the strand did not touch.
  shot.spheres = [](double) {
    return std::vector<Sphere>{{{-0.01, -0.08, 0}, 0.03}, {{0.05, -0.08, 0}, 0.04}, {{1, 0, 0}, 0.1}};
  };
  const Ran ran = run_with(shot, Precision::Double, {});
  CHECK(ran.work.spheres == 3);
  CHECK(ran.work.spheres_out_of_reach == 1);
  const Ran all = run_with(shot, Precision::Double, {.colliders = false});
  CHECK(all.work.spheres_out_of_reach == 0);
  CHECK(same(ran, all));
}

TEST_CASE("hair of a region that is not simulated rides on the head and takes less memory") {
  Shot shot;
  shot.groom = mixed_groom(5, 30, 15);
  shot.region.simulate = false;
  shot.head = dance;
  shot.frames = 3;
  const Ran ran = run_with(shot, Precision::Double, {});
  for (int frame = 1; frame <= shot.frames; ++frame) {
    const Isometry3d head = dance(frame / 60.0);
    double farthest = 0;
    for (std::size_t v = 0; v < shot.groom.vertex_count(); ++v) {
      farthest = std::max(farthest,
                          (ran.taken[static_cast<std::size_t>(frame) - 1][v] - head * shot.groom.position[v]).norm());
    }
    CHECK(farthest < 1e-15);
  }
  CHECK(ran.work.substeps == 0);
  RegionParams simulated;
  const Plan riding = plan_of(shot);
  Plan other = riding;
  other.regions[0] = plan_region(std::span(&simulated, 1), false);
  CHECK(2 * openmp_state_bytes(shot.groom, riding, {}) < openmp_state_bytes(shot.groom, other, {}));
}

TEST_CASE("the memory of a solver is known without making it") {
  Shot shot;
  shot.groom = mixed_groom(11, 50, 19);
  for (const Precision precision : {Precision::Float, Precision::Double}) {
    for (const int lanes : available_lanes()) {
      const SolverOptions options = {.precision = precision, .lanes = lanes};
      CHECK(openmp_state_bytes(shot.groom, plan_of(shot), options) ==
            make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), options)->state_bytes());
    }
  }
}
