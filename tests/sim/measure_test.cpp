// The figures of a frame, against the same worked out vertex by vertex from the positions that a solver hands out.
#include "sim/measure.h"

#include <catch2/catch.hpp>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;

namespace {

std::unique_ptr<Solver> measuring_solver(const Shot& shot, const SolverOptions& options) {
  Plan plan = plan_of(shot);
  plan.measured = true;
  return make_openmp_solver(shot.groom, plan, shot.head(0), options);
}

struct Exact {
  double stretch = 0, residual = 0, penetration = 0;
};

Exact worked_out(const Shot& shot, const Points& now, const std::vector<Sphere>& spheres) {
  Exact exact;
  const Groom& groom = shot.groom;
  const std::vector<std::uint8_t> pinned = pinned_vertices(groom);
  for (std::size_t s = 0; s < groom.strand_count(); ++s) {
    bool is_held = false;  // by a pinned vertex at the end of the segment or beyond
    for (std::size_t v = groom.offset[s + 1] - 1; v > groom.offset[s]; --v) {
      const double rest = (groom.position[v] - groom.position[v - 1]).norm();
      const double error = rest < 1e-5 ? 0 : std::abs((now[v] - now[v - 1]).norm() / rest - 1);
      is_held = is_held || (pinned[v] != 0 && v >= groom.offset[s] + 2);
      exact.stretch = std::max(exact.stretch, error);
      if (is_held && v >= groom.offset[s] + 2) exact.residual = std::max(exact.residual, error);
      for (const Sphere& sphere : spheres) {
        if (pinned[v] == 0)
          exact.penetration = std::max(exact.penetration, sphere.radius - (now[v] - sphere.center).norm());
      }
    }
  }
  return exact;
}

// Hair of every kind that stretches, is held at both ends, and hangs into a sphere.
Shot yielding_shot() {
  Shot shot = busy_shot();
  shot.regions_at = [regions_at = shot.regions_at](int frame) {
    std::vector<RegionParams> regions = regions_at(frame);
    regions[0].lengths = LengthParams::iterated(0);
    regions[1].lengths = LengthParams::iterated(1);
    return regions;
  };
  shot.frames = 6;
  return shot;
}

}  // namespace

TEST_CASE("figures are those of the positions") {
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const int lanes = GENERATE(from_range(available_lanes()));
  const Shot shot = yielding_shot();
  const auto solver = measuring_solver(shot, {precision, 2, lanes});
  const auto check = [&](const Figures& found, double time) {
    Points now(shot.groom.vertex_count());
    solver->read(now);
    const Exact exact = worked_out(shot, now, shot.spheres(time));
    // Floats in the world, a metre from its origin, on segments of 1e-5 m and more.
    const double rounding = precision == Precision::Float ? 1e-2 : 1e-6;
    CHECK(found.largest_stretch == Approx(exact.stretch).epsilon(1e-3).margin(rounding));
    CHECK(found.residual == Approx(exact.residual).epsilon(1e-3).margin(rounding));
    CHECK(found.deepest_penetration == Approx(exact.penetration).margin(1e-6));
    return exact;
  };
  check(solver->measure_at_start(shot.spheres(0)), 0);
  Exact exact;
  for (int frame = 1; frame <= shot.frames; ++frame) {
    Figures found;
    solver->advance(frame_input(shot, frame), {}, &found, {});
    exact = check(found, frame / shot.fps);
  }
  CHECK(exact.stretch > 0.02);
  CHECK(exact.residual > 0.02);
  CHECK(exact.penetration > 1e-3);
}

TEST_CASE("figures far from the origin of the world are what they are at it") {
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const Shot near = yielding_shot();
  Shot away = near;
  const Vector3d far(0x1p16, -0x1p14, 0x1p17);
  for (Vector3d& p : away.groom.position) p += far;
  away.head = [far](double time) {
    Isometry3d head = dance(time);
    head.translation() += far - head.linear() * far;
    return head;
  };
  away.spheres = [near, far](double time) {
    std::vector<Sphere> spheres = near.spheres(time);
    for (Sphere& sphere : spheres) sphere.center += far;
    return spheres;
  };
  const auto here = measuring_solver(near, {.precision = precision});
  const auto there = measuring_solver(away, {.precision = precision});
  for (int frame = 1; frame <= near.frames; ++frame) {
    Figures expected, found;
    here->advance(frame_input(near, frame), {}, &expected, {});
    there->advance(frame_input(away, frame), {}, &found, {});
    // The origins of the two differ by a grid of the groom's size; beside that, 1e-11 m in a double so far away.
    CHECK(found.largest_stretch == Approx(expected.largest_stretch).epsilon(1e-4).margin(1e-4));
    CHECK(found.residual == Approx(expected.residual).epsilon(1e-4).margin(1e-4));
    CHECK(found.deepest_penetration == Approx(expected.deepest_penetration).margin(1e-6));
  }
}

TEST_CASE("hair that rides on the head is not measured, be it skipped or not") {
  Shot shot = yielding_shot();
  shot.regions_at = [](int) {
    RegionParams riding;
    riding.simulate = false;
    return std::vector<RegionParams>(4, riding);
  };
  const bool skips = GENERATE(true, false);
  const auto solver = measuring_solver(shot, {.skip = {.regions = skips}});
  Figures found = {1, 1, 1};
  solver->advance(frame_input(shot, 1), {}, &found, {});
  CHECK(found.largest_stretch == 0);
  CHECK(found.residual == 0);
  CHECK(found.deepest_penetration == 0);
}

TEST_CASE("figures want a plan that has them measured") {
  const Shot shot = busy_shot();
  const auto solver = make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), {});
  Figures found;
  CHECK_THROWS_AS(solver->advance(frame_input(shot, 1), {}, &found, {}), std::invalid_argument);
  CHECK_THROWS_AS(solver->measure_at_start({}), std::invalid_argument);
  CHECK_NOTHROW(solver->advance(frame_input(shot, 1)));
}

TEST_CASE("the first two vertices of a strand are pinned, and those the groom names") {
  Groom groom = groom_of({straight(4, 1), straight(2, 1), straight(3, 1)});
  CHECK(pinned_vertices(groom) == std::vector<std::uint8_t>{1, 1, 0, 0, 1, 1, 1, 1, 0});
  pin(groom, 0, 3);
  CHECK(pinned_vertices(groom) == std::vector<std::uint8_t>{1, 1, 0, 1, 1, 1, 1, 1, 0});
  CHECK(pinned_vertices(groom_of({{{0, 0, 0}}})) == std::vector<std::uint8_t>{1});
}
