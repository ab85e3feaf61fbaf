// What the solver refuses, and what it says of numbers that are none.
#include <catch2/catch.hpp>
#include <limits>
#include <stdexcept>
#include <string>

#include "tests/sim/harness.h"

using namespace strandbake;
using namespace strandbake::harness;
using Catch::Matchers::Contains;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::unique_ptr<Solver> solver_of(const Shot& shot, const SolverOptions& options = {}) {
  return make_openmp_solver(shot.groom, plan_of(shot), shot.head(0), options);
}

}  // namespace

TEST_CASE("a strand of one vertex is refused by its number") {
  Shot shot;
  shot.groom = groom_of({straight(3, 0.1), straight(2, 0.1), {{0, 0, 0}}, straight(4, 0.1)});
  CHECK_THROWS_AS(solver_of(shot), std::invalid_argument);
  CHECK_THROWS_WITH(solver_of(shot), Contains("strand 2"));
}

TEST_CASE("a strand of no vertex is refused by its number") {
  Shot shot;
  shot.groom = groom_of({straight(3, 0.1), {}});
  CHECK_THROWS_WITH(solver_of(shot), Contains("strand 1"));
}

TEST_CASE("a region that the plan does not have is refused with the strand") {
  Shot shot;
  shot.groom = groom_of({straight(3, 0.1), straight(3, 0.1)});
  shot.groom.region = {0, 1};
  CHECK_THROWS_AS(solver_of(shot), std::invalid_argument);
  CHECK_THROWS_WITH(solver_of(shot), Contains("strand 1"));
}

TEST_CASE("lanes that the machine does not have are refused") {
  Shot shot;
  shot.groom = groom_of({straight(3, 0.1)});
  for (const int lanes : {-1, 1, 3, 5, 32, 1024}) {
    CHECK_THROWS_AS(solver_of(shot, {.lanes = lanes}), std::invalid_argument);
    CHECK_THROWS_WITH(solver_of(shot, {.lanes = lanes}), Contains(std::to_string(lanes)));
  }
  const std::vector<int> widths = available_lanes();
  CHECK_FALSE(widths.empty());
  CHECK(std::is_sorted(widths.begin(), widths.end()));
}

TEST_CASE("a groom without strands is simulated") {
  const Shot shot;
  const auto solver = solver_of(shot);
  solver->advance(frame_input(shot, 1));
  CHECK_FALSE(solver->find_non_finite());
  CHECK(solver->state_bytes() == 0);
}

TEST_CASE("a strand of two vertices only follows the head") {
  Shot shot;
  shot.groom = groom_of({straight(2, 0.1)});
  shot.head = dance;
  shot.frames = 5;
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  const Points end = run(shot, in_double()).back();
  for (std::size_t v = 0; v < 2; ++v) CHECK((end[v] - dance(5.0 / 60) * shot.groom.position[v]).norm() < 1e-15);
}

TEST_CASE("a strand of ten thousand vertices stays finite beside one of two") {
  Random random(41);
  Shot shot;
  shot.groom = groom_of({straight(2, 0.1), rambling(random, 10000, {0, 0, 0})});
  shot.head = dance;
  shot.frames = 3;
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  const auto solver = solver_of(shot);
  for (int frame = 1; frame <= shot.frames; ++frame) solver->advance(frame_input(shot, frame));
  CHECK_FALSE(solver->find_non_finite());
}

TEST_CASE("degenerate strands stay finite in motion") {
  Random random(42);
  Shot shot;
  shot.groom = groom_of({folded(30, 0.01), stuttering(random, 30, {0, 0, 0}), Points(10), straight(20, 1e-9),
                         straight(20, 1e-14), folded(30, 1e-5), straight(3, 100)});
  shot.head = dance;
  shot.wind.velocity = {5, 1, 0};
  shot.spheres = [](double time) {
    return std::vector<Sphere>{{dance(time) * Vector3d(0, 0, 0), 0.05}, {{0, 0, 0}, 0}};
  };
  shot.substeps = 2;
  shot.region.local.method = GENERATE(1, 2, 3, 4);
  shot.region.local.iterations = GENERATE(0, 5);
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const auto solver = solver_of(shot, {.precision = precision});
  for (int frame = 1; frame <= 40; ++frame) {
    solver->advance(frame_input(shot, frame));
    const auto found = solver->find_non_finite();
    CAPTURE(frame, found ? found->strand : 0, found ? found->vertex : 0);
    REQUIRE_FALSE(found);
  }
}

TEST_CASE("the first strand that is not finite is found, in the order of the groom") {
  const Precision precision = GENERATE(Precision::Float, Precision::Double);
  const int lanes = GENERATE(from_range(available_lanes()));
  Shot shot;
  // The solver sorts by length and region; the order of the groom is another.
  shot.groom = groom_of({straight(2, 0.1), straight(2, 0.1), straight(30, 0.1), straight(3, 0.1), straight(5, 0.1)});
  const auto solver = solver_of(shot, {precision, 1, lanes});
  CHECK_FALSE(solver->find_non_finite());
  solver->advance(frame_input(shot, 1));
  CHECK_FALSE(solver->find_non_finite());
  SECTION("infinite gravity spares what is pinned") {
    shot.gravity = {0, -kInfinity, 0};
    shot.region.local.iterations = 0;
    shot.region.lengths = LengthParams::iterated(0);
    solver->advance(frame_input(shot, 2));
    const auto found = solver->find_non_finite();
    REQUIRE(found);
    CHECK(found->strand == 2);
    CHECK(found->vertex == 2);
  }
  SECTION("a head that is nowhere spares nothing") {
    shot.head = [](double) { return pose(Eigen::Matrix3d::Identity(), {0, 0, std::nan("")}); };
    solver->advance(frame_input(shot, 2));
    const auto found = solver->find_non_finite();
    REQUIRE(found);
    CHECK(found->strand == 0);
    CHECK(found->vertex == 0);
  }
}

TEST_CASE("one strand that is not finite leaves the others alone") {
  Shot shot;
  shot.groom = groom_of({straight(5, 0.1), straight(5, 0.1, {1, 0, 0}), straight(4, 0.1, {2, 0, 0})});
  shot.groom.region = {0, 1, 0};
  shot.regions_at = [](int) {
    std::vector<RegionParams> regions(2);
    regions[0].drag = 0;
    return regions;
  };
  shot.wind.velocity = {kInfinity, 0, 0};
  const auto solver = solver_of(shot);
  solver->advance(frame_input(shot, 1));
  const auto found = solver->find_non_finite();
  REQUIRE(found);
  CHECK(found->strand == 1);
  Points now(shot.groom.vertex_count());
  solver->read(now);
  for (std::size_t v = 0; v < now.size(); ++v) {
    if (v < shot.groom.offset[1] || v >= shot.groom.offset[2]) CHECK(std::isfinite(now[v].norm()));
  }
}

TEST_CASE("an input that asks for more than the plan has is refused") {
  Shot shot;
  shot.groom = mixed_groom(47, 4, 10);
  shot.region.local.stiffness = 0;
  shot.region.global.stiffness = 0;
  const auto solver = solver_of(shot);
  FrameInput input;
  input.substep = 1.0 / 60;
  input.head = {Eigen::Isometry3d::Identity()};
  CHECK_THROWS_AS(solver->advance(input), std::invalid_argument);  // no region
  input.regions = {shot.region};
  CHECK_NOTHROW(solver->advance(input));
  input.wind.resize(2);
  CHECK_THROWS_AS(solver->advance(input), std::invalid_argument);  // another number of substeps
  input.wind.clear();
  input.regions[0].local.stiffness = 0.5;
  CHECK_THROWS_AS(solver->advance(input), std::invalid_argument);
  input.regions = {shot.region};
  input.regions[0].global = {0.5, 0.3, 1};
  CHECK_THROWS_AS(solver->advance(input), std::invalid_argument);
  input.regions[0].global.range = 0;
  CHECK_NOTHROW(solver->advance(input));  // pulls nothing
}

TEST_CASE("passes that the plan leaves out need no memory") {
  Shot shot;
  shot.groom = mixed_groom(43, 20, 30);
  const std::size_t everything = [&] {
    Shot full = shot;
    full.region.local.method = 2;
    full.wind.velocity = {1, 0, 0};
    return solver_of(full)->state_bytes();
  }();
  const std::size_t by_default = solver_of(shot)->state_bytes();
  shot.region.local.stiffness = 0;
  const std::size_t without_local = solver_of(shot)->state_bytes();
  shot.region.lengths = LengthParams::iterated(0);
  const std::size_t without_lengths = solver_of(shot)->state_bytes();
  shot.region.global.stiffness = 0;
  const std::size_t without_global = solver_of(shot)->state_bytes();
  CHECK(everything > by_default);
  CHECK(by_default > without_local);
  CHECK(without_local > without_lengths);
  CHECK(without_lengths > without_global);
  CHECK(solver_of(shot, in_double())->state_bytes() > 0);
}
